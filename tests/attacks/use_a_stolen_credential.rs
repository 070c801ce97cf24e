//! Somebody has stolen the machine that captures unattended: its home, and the credential that systemd handed over, but no
//! passphrase. He reads other topics, grants, and goes on sealing in the owner's name after she ended it.

use std::process::Command;

use authros::crypto::{Anchor, CryptoError, Expected, SealingKey, UnattendedCredential, open};
use authros::model::Timestamp;
use serde_json::Value;

use crate::forged_evidence::Scene;
use crate::parts::Parts;
use crate::support::authros::files_below;
use crate::support::{Authros, Home, text, wait_until};
use crate::{Outcome, judge};

const COVERED: &str = "/robot1/odom";
const REFUSED: i32 = 5;

/// The thief's copy of the home, without passphrases, on the chain of its owner.
fn stolen_home(scene: &Scene) -> (Home, Authros) {
    let home = Home::new();
    let copied = Command::new("cp").arg("-a").arg(scene.home.path()).arg(home.path()).status();
    assert!(copied.is_ok_and(|status| status.success()), "the home is copied");
    for path in files_below(&home.path()).into_iter().filter(|path| path.ends_with("passphrase")) {
        std::fs::remove_file(path).expect("removed");
    }
    let thief = home.profile("alice").with(&["--robots", "1", "--chain", &scene.served.url()]);
    (home, thief)
}

/// What the keys of the credential open of a record that alice seals.
fn opened(scene: &Scene, stolen: &UnattendedCredential, topic: &str) -> Result<Vec<u8>, CryptoError> {
    let alice = scene.stolen();
    let record = alice.record(&alice.keyring.signing, topic, 1, b"what alice saw");
    let SealingKey::Topics(keys) = &stolen.enrolment.keys.now.key else { panic!("the key of the epoch") };
    let (provider, signer) = (alice.provider(), &alice.keyring.signing.public);
    let expected = Expected::any_of(alice.domain, alice.address());
    let mut tries = keys.values().map(|issued| {
        open(provider, &record.blob, &record.signature, signer, Anchor::Unanchored, &issued.key, &expected)
    });
    let mut last = tries.next().expect("a key");
    for next in tries {
        last = last.or(next);
    }
    last.map(|record| record.body)
}

fn state(thief: &Authros) -> Value {
    thief.json(&["status"])["unattended"].clone()
}

#[tokio::test(flavor = "multi_thread")]
async fn use_a_stolen_credential() {
    let scene = Scene::new().await;
    scene.alice.json(&["topics", "watch", COVERED]);
    let file = scene.home.root().join("authros").to_str().expect("UTF-8").to_owned();
    scene.alice.json(&["unattended", "prepare", "--out", &file]);
    let stolen = UnattendedCredential::read(file.as_ref()).expect("it opens");
    let device = &stolen.enrolment.device;
    let mut parts = Parts::default();

    // While it stands it is what its owner gave away: the covered topic, and the signature under it.
    assert_eq!(opened(&scene, &stolen, COVERED).expect("the covered topic"), b"what alice saw");
    match opened(&scene, &stolen, "/robot2/odom") {
        Ok(_) => parts.reached("another topic".to_owned()),
        Err(error) => parts.refused("another topic", &error.to_string(), "this key does not open the record"),
    }
    let within = Timestamp::now();
    let honest = scene.forge(device, within).await;
    let Outcome::Succeeded(_) = scene.judge(&honest, "no such words") else { panic!("within the loan it may sign") };

    let (_home, thief) = stolen_home(&scene);
    let mut site = thief.spawn(&["serve", "--unattended", &file]);
    site.wait_for_text("serving", 120);
    assert_eq!(state(&thief)["state"], "capturing");
    for arguments in [&["grant", &scene.address, "--topic", COVERED][..], &["keys", "rotate"], &["unattended", "end"]] {
        let refused = thief.fails(REFUSED, arguments);
        parts.refused(arguments[0], &refused, "capture runs unattended until");
    }

    scene.alice.json(&["unattended", "end"]);
    let ended = wait_until(120, "the thief's site reads it from the chain", || {
        Some(state(&thief)).filter(|state| state["state"] == "ended")
    });
    parts.refused("further capture", &text(&ended, "why"), "recalled");
    site.stop("TERM", 30).expect_code(0);
    let folder = scene.forge(device, within).await;
    match scene.judge(&folder, "recalled") {
        Outcome::Refused(refusal) => parts.refused("a record signed afterwards", &refusal, "recalled"),
        Outcome::Succeeded(reached) => parts.reached(reached),
        Outcome::Otherwise(happened) => parts.otherwise(happened),
    }
    match opened(&scene, &stolen, COVERED) {
        Ok(_) => parts.reached("the covered topic, sealed after the end".to_owned()),
        Err(error) => parts.refused("the covered topic", &error.to_string(), "this key does not open the record"),
    }
    judge("use_a_stolen_credential", parts.outcome());
}
