//! Someone whom the administrator admitted by mistake registers after she has withdrawn the admission.

use crate::support::{Home, text};
use crate::{Outcome, judge};

#[test]
fn readmit_oneself() {
    let home = Home::new();
    let (boss, stranger) = (home.profile("boss"), home.profile("stranger"));
    boss.enrol();
    boss.json(&["chain", "admin", "close"]);
    let address = text(&stranger.json(&["identity", "create"]), "address");
    boss.json(&["chain", "admin", "allow", &address]);
    let withdrawn = boss.run(&["chain", "admin", "deny", &address]);
    let registered = stranger.with(&["--json"]).run(&["identity", "register"]);
    let outcome = if registered.code == Some(0) {
        let how = if withdrawn.code == Some(0) { "although it was withdrawn" } else { "which cannot be withdrawn" };
        Outcome::Succeeded(format!("{address} registered on its admission, {how}"))
    } else {
        let words = text(&registered.document()["error"], "message");
        let named = registered.code == Some(5) && words.contains("registration is closed");
        if named { Outcome::Refused(words) } else { Outcome::Otherwise(registered.to_string()) }
    };
    judge("readmit_oneself", outcome);
}
