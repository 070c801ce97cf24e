//! An operator founds a chain of his own under a clock of 2019, and wants anyone who checks a record of it to believe
//! that it existed in 2019: `evidence verify` against his own `chain serve` should say VERIFIED without saying whose clock it
//! was.

use crate::Outcome;
use crate::support::{Home, free_port, skipped, system_program, text};

#[test]
fn pass_off_an_old_chain() {
    let Some(faketime) = system_program("faketime") else { skipped!("no faketime") };
    let home = Home::new();
    let now = home.authros().with(&["--robots", "1"]);
    let program = now.program().to_str().expect("UTF-8").to_owned();
    let old = now
        .with_program(&faketime)
        .with_prefix(&["2019-03-03 12:00:00", &program])
        .with_variable("FAKETIME_DONT_FAKE_MONOTONIC", "1");
    old.run(&["identity", "register"]).expect_code(0);
    old.run(&["capture", "--count", "1", "--topic", "/robot1/odom"]).expect_code(0);
    let id = text(&now.records(&["records", "list", "--oldest"])[0], "id");
    let folder = home.root().join("evidence");
    let folder = folder.to_str().expect("UTF-8");
    now.run(&["records", "export", &id, "--dir", folder]).expect_code(0);

    let port = free_port().to_string();
    let mut chain = now.spawn(&["chain", "serve", "--listen", &format!("127.0.0.1:{port}")]);
    chain.wait_for_text(&port, 60);
    let url = format!("http://127.0.0.1:{port}");
    let checked = now.run(&["evidence", "verify", folder, "--chain", &url]);
    let document = now.with(&["--json"]).run(&["evidence", "verify", folder, "--chain", &url]).document();
    chain.stop("INT", 30);

    let said = &checked.stdout;
    assert!(said.contains("captured 2019-03-03"), "the record claims 2019: {checked}");
    let honest = said.contains("existed no later than 2019-03-03")
        && said.contains("WARNING")
        && said.contains("a single program seals")
        && said.contains("the owner's claim")
        && document["anchored"]["time"].is_string()
        && document["sealed_by"]["kind"] == "embedded"
        && document["warnings"].as_array().is_some_and(|warnings| !warnings.is_empty());
    let verdict = said.lines().find(|line| line.contains("VERIFIED")).unwrap_or_default().trim().to_owned();
    let outcome = match (honest, verdict.is_empty()) {
        (true, false) => Outcome::Refused(verdict),
        (false, false) => {
            Outcome::Succeeded(format!("`evidence verify` says of a chain founded by its operator's clock: {verdict}"))
        }
        (_, true) => Outcome::Otherwise(checked.to_string()),
    };
    crate::judge("pass_off_an_old_chain", outcome);
}
