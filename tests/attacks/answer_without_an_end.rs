//! To fill the memory of a site with an answer that never ends, as its node or as its cache.

use std::io::{Read as _, Write as _};
use std::net::{TcpListener, TcpStream};
use std::time::Duration;

use crate::support::process::peak_memory;
use crate::support::{Authros, Home, free_port};
use crate::{Outcome, judge};

/// What an answer may add to the memory of a command that gets none, KiB.
const MORE: u64 = 200 * 1024;

/// A server that answers every request with `begin`, and then for as long as anybody reads with `piece`.
fn endless(begin: &'static [u8], piece: &'static [u8]) -> u16 {
    let listener = TcpListener::bind("127.0.0.1:0").expect("binds");
    let port = listener.local_addr().expect("an address").port();
    let answer = move |mut stream: TcpStream| {
        drop(stream.read(&mut [0; 4096]));
        drop(stream.write_all(begin));
        let pieces = piece.repeat((1 << 20) / piece.len());
        while stream.write_all(&pieces).is_ok() {}
    };
    std::thread::spawn(move || {
        for stream in listener.incoming().map_while(Result::ok) {
            std::thread::spawn(move || answer(stream));
        }
    });
    port
}

/// What a command says, and the most memory that it ever held, KiB.
fn measured(authros: &Authros, arguments: &[&str]) -> (String, u64) {
    let mut command = authros.spawn(arguments);
    let mut peak = 0;
    for _ in 0..6000 {
        if !command.is_running() {
            break;
        }
        peak = peak.max(peak_memory(command.id()).unwrap_or(0));
        std::thread::sleep(Duration::from_millis(10));
    }
    let outcome = command.wait(10);
    (format!("{}{}", outcome.stdout, outcome.stderr), peak)
}

fn judge_peer(attack: &str, options: impl Fn(u16) -> [String; 2], port: u16, words: &[&str]) {
    let home = Home::new();
    home.authros().json(&["identity", "create"]);
    let with = |port| {
        let [name, value] = options(port);
        home.authros().with(&["--robots", "0", &name, &value])
    };
    let (_, usual) = measured(&with(free_port()), &["doctor"]);
    let (said, peak) = measured(&with(port), &["doctor"]);
    let shown = format!("{} MiB, without an answer {} MiB", peak / 1024, usual / 1024);
    println!("{attack}: {shown}");
    judge(
        attack,
        if peak > usual + MORE {
            Outcome::Succeeded(shown)
        } else if words.iter().all(|word| said.contains(word)) {
            Outcome::Refused(said.lines().find(|line| line.contains(words[0])).unwrap_or_default().trim().to_owned())
        } else {
            Outcome::Otherwise(said)
        },
    );
}

#[test]
fn answer_without_an_end_as_a_node() {
    let begin =
        b"HTTP/1.1 200 OK\r\nContent-Type: application/json\r\n\r\n{\"jsonrpc\":\"2.0\",\"id\":1,\"result\":\"0x";
    for (attack, begin) in [
        ("answer-without-an-end-as-a-node", &begin[..]),
        ("answer-without-an-end-as-a-refusal", b"HTTP/1.1 503 Service Unavailable\r\n\r\n<html>"),
    ] {
        let words =
            if attack.ends_with("node") { ["sent more than 4 MiB", "eth_chainId"] } else { ["HTTP 503", "node"] };
        let options = |port| ["--chain".to_owned(), format!("http://127.0.0.1:{port}")];
        judge_peer(attack, options, endless(begin, b"0"), &words);
    }
}

#[test]
fn answer_without_an_end_as_a_cache() {
    for (attack, begin, piece, words) in [
        ("answer-without-an-end-as-a-cache", &b"$9000000000000\r\n"[..], &b"0"[..], ["more than 72 MiB", "cache"]),
        ("a-list-without-an-end-as-a-cache", b"*600000\r\n", b"$4\r\nabcd\r\n", ["list of 600000 values", "cache"]),
        ("lists-in-lists-without-an-end-as-a-cache", b"*1\r\n", b"*1\r\n", ["deeper than any reply", "cache"]),
    ] {
        let options = |port| ["--cache".to_owned(), format!("redis://127.0.0.1:{port}")];
        judge_peer(attack, options, endless(begin, piece), &words);
    }
}
