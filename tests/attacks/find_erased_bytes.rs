//! Someone who gets the disk of a site looks for the bytes of a recording that was erased: in the store's file, its log
//! and everything else in the home, while the site runs and after it has ended.

use crate::support::erased::{pieces_of, with_any};
use crate::support::{Home, is_verified, text, wait_until};
use crate::{Outcome, judge};

const TOPIC: &str = "/robot1/camera/compressed";

#[test]
fn find_erased_bytes() {
    let home = Home::new();
    let authros = home.authros().with(&["--robots", "1"]);
    let site = authros.serve(&home);
    authros.enrol();
    authros.capture(&[TOPIC, "/robot1/odom"], 5);
    let records = wait_until(120, "all is verified", || {
        let records = authros.records(&["records", "list", "--oldest", "--topic", TOPIC]);
        (records.len() >= 5 && records.iter().all(is_verified)).then_some(records)
    });
    let pieces = pieces_of(&home, &records);
    assert!(!with_any(&home.path(), &pieces).is_empty(), "the search finds what is there");

    authros.json(&["records", "erase", "--topic", TOPIC, "--reason", "a face is in it", "--yes"]);
    wait_until(120, "they are gone", || {
        let records = authros.records(&["records", "list", "--oldest", "--topic", TOPIC]);
        records.iter().all(|record| record["state"] == "deleted").then_some(())
    });
    let while_it_runs = with_any(&home.path(), &pieces);
    site.stop("TERM", 30).expect_code(0);
    let afterwards = with_any(&home.path(), &pieces);
    let shown = authros.json(&["records", "check", &text(&records[0], "id")]);
    let outcome = match (while_it_runs.is_empty(), afterwards.is_empty()) {
        (true, true) if shown["verdict"] == "deleted" => Outcome::Refused(format!(
            "none of {} pieces of ciphertext is in any file, and the record's proof still stands",
            pieces.len()
        )),
        (true, true) => Outcome::Otherwise(format!("the bytes are gone, but the record checks as {shown}")),
        _ => Outcome::Succeeded(format!("ciphertext in {while_it_runs:?} {afterwards:?}")),
    };
    judge("find_erased_bytes", outcome);
}
