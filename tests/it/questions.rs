//! An incident disclosed by one command; what its verdict, its page and `--json` count is the same; and the questions of a
//! judge (`tests/questions.md`) are answered by lines of them. With `AUTHROS_WRITE_QUESTIONS` that page is written again.
#![allow(clippy::expect_used, clippy::panic, reason = "a test fails by panicking")]

use std::fs;
use std::path::{Path, PathBuf};

use serde_json::Value;

use crate::evidence::{printed, unzipped, verified};
use crate::support::{Authros, Home, count, list, skipped, system_program, text, wait_until};

const TOPICS: [&str; 2] = ["/robot1/odom", "/robot2/odom"];
const PAGE: &str = concat!(env!("CARGO_MANIFEST_DIR"), "/tests/questions.md");

/// The sentences that these lines were wrapped from, each with its first line's number.
fn sentences(lines: &str) -> Vec<(usize, String)> {
    let mut sentences: Vec<(usize, String)> = Vec::new();
    for (number, line) in (1..).zip(lines.trim_end().lines()) {
        match (line.strip_prefix("  "), sentences.last_mut()) {
            (Some(more), Some((_, sentence))) => *sentence = format!("{sentence} {more}"),
            _ => sentences.push((number, line.to_owned())),
        }
    }
    sentences
}

/// Without what differs from run to run: accounts, counts, times.
fn lasting(sentence: &str) -> String {
    let word = |word: &str| match word.contains(|letter: char| letter.is_ascii_digit()) && !word.contains('/') {
        true => "#".to_owned(),
        false => word.to_owned(),
    };
    let mut words: Vec<String> = sentence.split(' ').map(word).collect();
    words.dedup_by(|one, before| one == "#" && before == "#");
    // A span within one second is one time.
    words.join(" ").replace("# to #", "#").replace("# records", "# record")
}

struct Case {
    _home: Home,
    view: Value,
    bundle: PathBuf,
    trust: PathBuf,
    verdict: String,
}

/// Exported until the recorder's own statement covers both topics.
fn case() -> Case {
    let home = Home::new();
    let authros = home.authros().with(&["--robots", "2"]).with_variable("AUTHROS_AUDIT_ANCHOR_EVERY", "1");
    authros.enrol();
    authros.capture(&TOPICS, 3);
    let opened = ["incident", "open", "crash", "--since", "-10m", "--topics", TOPICS[0], TOPICS[1]];
    authros.json(&opened);
    asked(&authros, &home);
    let site = authros.serve(&home);
    let (trust, mut tries) = (home.root().join("trust.toml"), 0);
    let (view, bundle, verdict) = wait_until(90, "the recorder states the newest numbers of both topics", || {
        tries += 1;
        let file = home.root().join(format!("crash{tries}.authros"));
        let place = file.to_str().expect("UTF-8");
        let view = authros.json(&["evidence", "export", place, "--incident", "crash", "--reveal", "all", "--yes"]);
        fs::write(&trust, unzipped(&file, "trust.toml")).expect("written");
        let verdict = printed(&file, &trust, &[]);
        let is_covered = ["Complete: 2 topics", "; 2 are statements"].iter().all(|part| verdict.contains(part));
        is_covered.then_some((view, file, verdict))
    });
    site.stop("INT", 30).expect_code(0);
    let audit = list(&authros.json(&["audit", "list", "--limit", "1000"]), "audit");
    let disclosed: Vec<String> =
        audit.iter().filter(|line| line["action"] == "disclose topic").map(|line| text(line, "subject")).collect();
    assert!(TOPICS.iter().all(|topic| disclosed.iter().any(|subject| subject.starts_with(topic))), "{disclosed:?}");
    Case { _home: home, view, bundle, trust, verdict }
}

/// Without a confirmation nothing is written, and what would become readable is counted.
fn asked(authros: &Authros, home: &Home) {
    let file = home.root().join("asked.authros");
    let export = ["evidence", "export", file.to_str().expect("UTF-8"), "--incident", "crash"];
    for reveal in [&["--reveal", "all"], &["--reveal-topic", "/robot*/odom"]] {
        let told = authros.run(&[&export[..], &reveal[..]].concat());
        assert!(told.code == Some(2) && !file.exists(), "{told}");
        assert!(
            told.stdout.contains(" records of 2 topics would be readable to everybody who gets the file"),
            "{told}"
        );
        assert!(TOPICS.iter().all(|topic| told.stdout.contains(&format!(" of {topic}"))), "{told}");
    }
    let message = authros.fails(3, &[&export[..], &["--reveal-topic", "/never/*"]].concat());
    assert!(message.contains("no chosen message has a topic that matches /never/*"), "{message}");
}

fn counts_agree(case: &Case, told: &[(usize, String)]) {
    let report = verified(&case.bundle, Some(&case.trust)).expect_code(8).document();
    let records = list(&report, "records");
    let is_statement = |record: &&Value| record["disclosed"]["topic"] == "authros/recorder";
    let statements = records.iter().filter(is_statement).count();
    let opened = records.iter().filter(|record| record["disclosed"].is_object()).count() - statements;
    assert_eq!((records.len() as u64, opened as u64), (count(&case.view, "records"), count(&case.view, "revealed")));
    let of_topics: u64 = list(&case.view, "topics").iter().map(|topic| count(topic, "records")).sum();
    assert_eq!(of_topics, count(&case.view, "revealed"), "{}", case.view);
    let verdict: Vec<String> = told.iter().map(|(_, sentence)| sentence.clone()).collect();
    assert_eq!(Value::from(verdict.clone()), report["verdict"], "--json has the same sentences");
    let whole = format!("The file has {} records; {statements} are statements", records.len());
    assert!(verdict.iter().any(|one| one.starts_with(&whole)), "{verdict:#?}");
    for topic in list(&case.view, "topics") {
        let (name, number) = (text(&topic, "topic"), count(&topic, "records"));
        let readable = format!("Readable: {number} records of {name}, ");
        assert!(verdict.iter().any(|one| one.starts_with(&readable)), "{readable} in {verdict:#?}");
    }
    // The page was made with the trust file that the bundle suggests, which the test took.
    let page = String::from_utf8(unzipped(&case.bundle, "report.html")).expect("text");
    let (first, _) = page.split_once("</section>").expect("a first page");
    for sentence in &verdict {
        assert!(first.contains(&sentence.replace('\'', "&#39;")), "{sentence} in {first}");
    }
    for part in ["<svg", "Timeline", "<rect", "crash"] {
        assert!(page.contains(part), "no {part} in {page}");
    }
}

/// Rows of the page: number, question, answer.
fn rows(page: &str) -> Vec<(String, String)> {
    let rows = page.lines().filter(|line| line.starts_with("| ") && !line.starts_with("| No."));
    rows.map(|row| {
        let cells: Vec<&str> = row.trim_matches('|').split(" | ").map(str::trim).collect();
        (cells[1].to_owned(), cells[3].trim_matches('|').trim().to_owned())
    })
    .collect()
}

fn write(told: &[(usize, String)], page: &str) {
    let (head, _) = page.split_once("| No.").expect("a table");
    let mut lines = vec!["| No. | Question | Line | Answer |".to_owned(), "|---|---|---|---|".to_owned()];
    for (number, (question, answer)) in (1..).zip(rows(page)) {
        let (line, sentence) = answering(told, &answer);
        lines.push(format!("| {number} | {question} | {line} | {sentence} |"));
    }
    fs::write(PAGE, format!("{head}{}\n", lines.join("\n"))).expect("written");
}

fn answering<'a>(told: &'a [(usize, String)], answer: &str) -> (usize, &'a str) {
    let found = told.iter().find(|(_, sentence)| lasting(sentence) == lasting(answer));
    let (line, sentence) = found.unwrap_or_else(|| panic!("no sentence says '{answer}' in {told:#?}"));
    (*line, sentence)
}

#[test]
fn a_judges_twenty_questions_are_answered_and_all_counts_agree() {
    if system_program("python3").is_none() {
        skipped!("no python3");
    }
    let case = case();
    let told = sentences(&case.verdict);
    assert!(case.verdict.lines().count() <= 25, "{}", case.verdict);
    counts_agree(&case, &told);
    let page = fs::read_to_string(Path::new(PAGE)).expect("tests/questions.md");
    let questions = rows(&page);
    assert_eq!(questions.len(), 20);
    for (_, answer) in &questions {
        answering(&told, answer);
    }
    if std::env::var_os("AUTHROS_WRITE_QUESTIONS").is_some() {
        write(&told, &page);
    }
}
