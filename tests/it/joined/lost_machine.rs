//! The machine of an owner is lost after a backup: epochs began since and the identity's keys changed, on a chain and at a
//! gateway that were not restored with it. Every record opens again; the robot and the reader go on.

use super::*;
use crate::support::skipped;

/// A secret key in the form that `keys load --sm2` reads.
const SIGNING_KEY: &str = "3945208f7b2144b13f36e38ac6d39f95889393692860b51a42fb81ef4df7c5b8";

/// The next epoch, and some records of the robot in it.
fn begin_epoch(owner: &Member, robot: &Robot) -> u64 {
    owner.authros.json(&["keys", "rotate"]);
    robot.bring("3")
}

/// The same owner on another machine, with what a backup has of it.
fn restored(gateway: &Gateway, lost: Member, file: &str, secret: &str) -> Member {
    let Member { home, address, site, .. } = lost;
    site.expect("running").stop("KILL", 10);
    drop(home);
    let home = Home::new();
    let authros = home
        .profile("alice")
        .with_variable("AUTHROS_SITE", &gateway.address())
        .with_variable("AUTHROS_GATEWAY_KEY", &gateway.key);
    authros.json(&["backup", "restore", file, "--passphrase-file", secret]);
    // Before the chain returned keys, it ended here: the keyring lacks the key of its current epoch.
    let site = Some(authros.serve(&home));
    Member { home, authros, address, site }
}

fn everything_opens_after_the_machine_is_lost(ground: &Ground) {
    let gateway = Gateway::new(ground);
    let at = gateway.address();
    let alice = Member::at(Some(ground), "alice", (&gateway, &[&at]));
    let bob = Member::at(Some(ground), "bob", (&gateway, &[&at]));
    alice.grant(&bob);
    let robot = Robot::enrol(&alice, "scout", &gateway);
    robot.bring("3");
    let secret = bob.home.file("secret", "a passphrase of its own\n", 0o600);
    let file = bob.home.root().join("alice.backup").to_str().expect("UTF-8").to_owned();
    alice.authros.json(&["backup", "create", &file, "--passphrase-file", &secret]);

    begin_epoch(&alice, &robot);
    alice.authros.json(&["keys", "rotate", "--envelope"]);
    begin_epoch(&alice, &robot);
    let key = bob.home.file("sm2", SIGNING_KEY, 0o600);
    alice.authros.run(&["keys", "load", "--sm2", &key]).expect_code(0);
    alice.authros.json(&["keys", "rotate", "--envelope"]);
    let all = begin_epoch(&alice, &robot);
    let own = alice.verified(&["records", "list", "--oldest"], all);
    let newest = alice.authros.json(&["keys", "list"]);

    let alice = restored(&gateway, alice, &file, &secret);
    assert_eq!(alice.verified(&["records", "list", "--oldest"], all), own, "all are here again");
    let now = alice.authros.json(&["keys", "list"]);
    for field in ["signing_key", "envelope_key", "epochs"] {
        assert_eq!(now[field], newest[field], "{field}");
    }
    for id in &own {
        let opened = alice.authros.json(&["records", "open", id]);
        assert_eq!(opened["verdict"], "verified", "{opened}");
    }
    let status = alice.authros.json(&["status"]).to_string();
    assert!(!status.contains("lacks the keys"), "{status}");

    // The robot goes on under the epoch that it has, and under one that the restored owner begins.
    robot.bring("3");
    let all = begin_epoch(&alice, &robot);
    let own = alice.verified(&["records", "list", "--oldest"], all);
    assert_eq!(
        bob.verified(&["received", "list", "--oldest", "--owner", &alice.address], all),
        own,
        "the reader has the same"
    );
    for id in &own {
        assert_eq!(bob.authros.json(&["records", "open", id])["verdict"], "verified", "{id}");
    }
}

#[test]
fn an_old_backup_opens_everything_on_the_embedded_chain() {
    let _alone = heavy();
    everything_opens_after_the_machine_is_lost(&Ground::new());
}

#[test]
fn an_old_backup_opens_everything_on_a_real_chain() {
    let _alone = heavy();
    let Some(ground) = Ground::on_anvil() else { skipped!("no anvil; tests/run installs it into target/peers") };
    everything_opens_after_the_machine_is_lost(&ground);
}
