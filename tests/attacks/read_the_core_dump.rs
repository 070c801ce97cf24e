//! Someone who sees the program crash looks for keys in its core file.

use std::fs;
use std::path::Path;

use crate::support::{Home, holds, unhex, wait_until};
use crate::{Outcome, judge};

/// Allows cores of any size to be written, then becomes the program.
const ALLOWING: &str = "ulimit -c unlimited || exit 99; exec \"$@\"";

#[test]
fn read_the_core_dump() {
    let home = Home::new();
    let authros = home.authros().with(&["--robots", "0"]);
    authros.enrol();
    let file = home.root().join("sm4").to_str().expect("UTF-8").to_owned();
    authros.run(&["keys", "export", "sm4", "--out", &file]).expect_code(0);
    let key = unhex(fs::read_to_string(&file).expect("written").trim());
    assert_eq!(key.len(), 16, "K_C");

    let program = authros.program().to_str().expect("UTF-8").to_owned();
    let allowing = authros.with_program(Path::new("/bin/bash")).with_prefix(&["-c", ALLOWING, "bash", &program]);
    let site = allowing.serve(&home);
    wait_until(60, "its keyring is open", || (authros.json(&["identity", "show"])["unlocked"] == true).then_some(()));
    let limits = fs::read_to_string(format!("/proc/{}/limits", site.id())).expect("it runs");
    let limit = limits.lines().find(|line| line.starts_with("Max core file size")).unwrap_or_default();
    let limit = limit.split_whitespace().collect::<Vec<_>>().join(" ");
    site.stop("ABRT", 30);

    let outcome = match core_in(home.root()) {
        Some(core) if holds(&core, &key) => Outcome::Succeeded(format!("K_C in a core of {} bytes", core.len())),
        Some(core) => Outcome::Succeeded(format!("a core of {} bytes", core.len())),
        None if limit.starts_with("Max core file size 0 0") => {
            Outcome::Refused(format!("no core was written; {limit}"))
        }
        None => Outcome::Otherwise(format!("no core was written here, though {limit}")),
    };
    judge("read_the_core_dump", outcome);
}

fn core_in(directory: &Path) -> Option<Vec<u8>> {
    let files = fs::read_dir(directory).expect("readable").flatten().map(|entry| entry.path());
    let named =
        |path: &Path| path.file_name().and_then(|name| name.to_str()).is_some_and(|name| name.starts_with("core"));
    files.filter(|path| named(path)).find_map(|path| fs::read(path).ok())
}
