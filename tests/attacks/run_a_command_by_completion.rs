//! Someone whose records are in a home wants a command of his to run there: a topic's name that the shell's completion
//! puts into the operator's line, to be run at Enter.

use std::process::Command;

use crate::support::{Home, skipped, system_program};
use crate::{Outcome, judge};

#[test]
fn run_a_command_by_completion() {
    let Some(bash) = system_program("bash") else {
        skipped!("there is no bash");
    };
    let home = Home::new();
    let authros = home.authros().with(&["--robots", "1"]);
    authros.capture(&["/robot1/odom"], 1);
    let ledger = rusqlite::Connection::open(home.path().join("ledger.db")).expect("the ledger opens");
    let proof = home.root().join("pwned");
    let names = [
        format!("/x;touch${{IFS}}{};", proof.display()),
        format!("/x$(touch${{IFS}}{})", proof.display()),
        format!("/x`touch${{IFS}}{}`", proof.display()),
    ];
    let script = home.file("authros.bash", authros.run(&["--print-completions", "bash"]).expect_code(0).stdout, 0o600);
    let path = format!(
        "{}:{}",
        authros.program().parent().expect("a folder").display(),
        std::env::var("PATH").unwrap_or_default()
    );
    let root = home.path().display().to_string();
    for name in names {
        assert!(ledger.execute("UPDATE topics SET name = ?1", [&name]).expect("renamed") >= 1);
        // What the operator types, what completion makes of it, and Enter.
        let line = format!(
            "source {script}; COMP_WORDS=(authros --home {root} records list --topic /x); COMP_CWORD=6; \
             _authros_words authros /x ''; eval \"true ${{COMPREPLY[0]}}\""
        );
        let run = Command::new(&bash).args(["--norc", "-c", &line]).env("PATH", &path).output().expect("bash runs");
        assert!(run.status.success(), "{}", String::from_utf8_lossy(&run.stderr));
        if proof.exists() {
            return judge(
                "run_a_command_by_completion",
                Outcome::Succeeded(format!("the name {name} ran as a command")),
            );
        }
    }
    let offered = authros.run(&["complete", "topic", "/"]).expect_code(0).stdout;
    let outcome = if offered.is_empty() {
        Outcome::Refused("no such name is offered".to_owned())
    } else {
        Outcome::Succeeded(format!("offered: {offered}"))
    };
    judge("run_a_command_by_completion", outcome);
}
