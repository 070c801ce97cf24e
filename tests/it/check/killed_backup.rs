//! A backup that is killed leaves nothing behind: no copy of store or chain in the home, which no erasure would
//! reach, and no half file in the folder of the backups.

use std::fs;
use std::path::Path;

use super::all_verified;
use crate::support::authros::files_below;
use crate::support::{Home, faulty, heavy, poll, skipped};

const TOPIC: &str = "/robot1/odom";
const UNFINISHED: &str = ".authros-new-";

/// What is left unfinished in a folder or below it.
fn left_in(folder: &Path) -> Vec<String> {
    let shown = files_below(folder).into_iter().map(|path| path.display().to_string());
    shown.filter(|path| path.contains(UNFINISHED)).collect()
}

#[test]
fn a_killed_backup_leaves_nothing_in_the_home_nor_beside_the_others() {
    let _alone = heavy();
    let Some(program) = faulty() else { skipped!("no authros-faulty (cargo test builds it with the examples)") };
    let home = Home::new();
    let authros = home.authros().with(&["--robots", "1"]);
    authros.enrol();
    authros.capture(&[TOPIC], 5);
    all_verified(&authros, 5);
    let secret = home.file("secret", "a passphrase of its own\n", 0o600);
    let folder = home.root().join("backups");
    fs::create_dir(&folder).expect("a folder");
    let foreign = folder.join(".new-by-somebody-else");
    fs::write(&foreign, b"not ours").expect("written");
    let path = |number: usize| folder.join(format!("{number}.backup")).to_str().expect("UTF-8").to_owned();
    let places = ["backup-moment", "backup-copied", "backup-sealed", "file-unfinished"];
    let mut seen = 0;
    for (number, place) in places.into_iter().enumerate() {
        let mut site = authros.with_program(&program).with_variable("AUTHROS_FAIL_POINT", place).spawn(&["serve"]);
        poll(60, || (home.socket().is_some() || !site.is_running()).then_some(())).expect("a socket");
        // A file that is replaced: the keyring by the rotation, which a backup does not touch.
        let words: &[&str] = match place {
            "file-unfinished" => &["keys", "rotate"],
            _ => &["backup", "create", &path(number), "--passphrase-file", &secret],
        };
        let told = authros.spawn(words).wait(60);
        assert!(poll(60, || (!site.is_running()).then_some(())).is_some(), "it ends at the place {place}: {told}");
        let mut left = left_in(&home.path());
        left.extend(left_in(&folder));
        seen += left.len();
        assert!(!Path::new(&path(number)).exists(), "{place}: no half file has the name of a backup");

        let site = authros.serve(&home);
        // Fails where only the copies are left out of the next backup, and nobody removes them.
        assert_eq!(left_in(&home.path()), Vec::<String>::new(), "{place}: the next start removes it");
        authros.json(&["backup", "create", &path(100 + number), "--passphrase-file", &secret]);
        assert_eq!(left_in(&folder), Vec::<String>::new(), "{place}: and so does the next backup");
        site.stop("TERM", 30).expect_code(0);
    }
    assert!(seen > 0, "nothing was killed in the middle");
    assert!(foreign.exists(), "what is not ours stays");
    assert_eq!(left_in(&home.path()), Vec::<String>::new());
}
