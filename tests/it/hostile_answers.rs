//! Every list of the command line, of a site whose every free text is hostile: no character of it acts on the terminal.
//! The answers are in `tests/support/answers.json`; "n" there is free text.
#![allow(clippy::expect_used, clippy::panic, reason = "a test fails by panicking")]

use std::io::{BufRead as _, BufReader, Write as _};
use std::os::unix::net::{UnixListener, UnixStream};
use std::sync::{Arc, Mutex, PoisonError};

use authros::service::Reply;
use serde_json::{Value, json};

use crate::support::hostile::{Hostile, foreign_in_lines};
use crate::support::{Authros, Home, long, text};

const ANSWERS: &str = include_str!("../support/answers.json");
/// What stands for free text.
const FREE: &str = "n";
/// Rows of a list.
const ROWS: usize = 20;

/// The same answer with a name wherever free text is, and lists of `ROWS` rows.
fn told(answer: &Value, name: &mut dyn FnMut() -> String) -> Value {
    match answer {
        Value::String(text) if text == FREE => Value::from(name()),
        Value::Array(items) => {
            let is_list = items.len() == 1 && items[0].is_object();
            let times = if is_list { ROWS } else { 1 };
            (0..times).flat_map(|_| items).map(|item| told(item, name)).collect()
        }
        Value::Object(fields) => fields
            .iter()
            .map(|(field, value)| (field.clone(), told(value, name)))
            .collect::<serde_json::Map<_, _>>()
            .into(),
        other => other.clone(),
    }
}

/// A request's name; of a group's requests with the group's.
fn name_of(command: &Value) -> String {
    let group = text(command, "command");
    let member = ["robot", "incident"].into_iter().find(|member| group == format!("of_{member}"));
    member.map_or_else(|| group.clone(), |member| format!("{group} {}", text(command, member)))
}

/// What the stub answers, and what it was asked for.
#[derive(Debug, Default)]
struct Script {
    answer: Value,
    asked: Vec<String>,
}

/// A site that answers every request with the script's answer.
fn stub(home: &Home, script: &Arc<Mutex<Script>>) -> String {
    let path = home.root().join("stub.sock").to_str().expect("UTF-8").to_owned();
    let listener = UnixListener::bind(&path).expect("a socket");
    let script = Arc::clone(script);
    std::thread::spawn(move || {
        for stream in listener.incoming().flatten() {
            // A command that ends early is seen by what it prints.
            drop(converse(stream, &script));
        }
    });
    path
}

fn converse(mut stream: UnixStream, script: &Mutex<Script>) -> std::io::Result<()> {
    let greeting = json!({ "version": "stub", "settings": [], "stays": true, "has": { "ros": true, "chain": true } });
    writeln!(stream, "{}", json!({ "greeting": greeting }))?;
    for line in BufReader::new(stream.try_clone()?).lines() {
        let request: Value = serde_json::from_str(&line?)?;
        let mut script = script.lock().unwrap_or_else(PoisonError::into_inner);
        script.asked.push(name_of(&request["command"]));
        let answer = json!({ "number": request["number"], "with": { "Ok": script.answer } });
        drop(script);
        writeln!(stream, "{}", json!({ "answer": answer }))?;
    }
    Ok(())
}

#[test]
fn no_list_of_the_command_line_passes_on_what_acts_on_a_terminal() {
    let home = Home::new();
    let script = Arc::new(Mutex::new(Script::default()));
    let socket = stub(&home, &script);
    let authros = Authros::bare(home.root()).with(&["--site-socket", &socket]);
    let samples: Vec<Value> = serde_json::from_str(ANSWERS).expect("JSON");
    let run = |sample: &Value, name: &mut dyn FnMut() -> String| {
        let answer = told(&sample["answer"], name);
        let read: Result<Reply, _> = serde_json::from_value(answer.clone());
        assert!(read.is_ok(), "{}: {:?}", sample["line"], read.err());
        *script.lock().expect("a script") = Script { answer, asked: Vec::new() };
        let line = text(sample, "line");
        let outcome = authros.run(&line.split(' ').collect::<Vec<_>>());
        let asked = std::mem::take(&mut script.lock().expect("a script").asked);
        assert_eq!(asked, [text(sample, "asks")], "{line}: {outcome}");
        outcome
    };
    let codes: Vec<Option<i32>> = samples
        .iter()
        .map(|sample| {
            let outcome = run(sample, &mut || "plain".to_owned());
            assert!(outcome.stdout.contains("plain"), "its names are told: {outcome}");
            outcome.code
        })
        .collect();
    let (wanted, mut hostile) = (if long() { 200_000 } else { 4_000 }, Hostile::new(0xc11));
    while hostile.names < wanted {
        for (sample, code) in samples.iter().zip(&codes) {
            let outcome = run(sample, &mut || hostile.name());
            assert_eq!(outcome.code, *code, "{outcome}");
            for told in [&outcome.stdout, &outcome.stderr] {
                assert_eq!(foreign_in_lines(told), None, "{}", sample["line"]);
            }
        }
    }
    println!("{} hostile names in {} lists", hostile.names, samples.len());
}
