//! Scheduled backups: a new file in a folder, removing the oldest of its kind; and the drill that shows one of them can
//! be restored.

use std::path::{Path, PathBuf};

use super::audit::AuditArguments;
use super::check::{absolute, backed_up, backup_passphrase};
use super::connect::{Connection, Context};
use super::plans;
use super::verbs::{self, NEITHER};
use crate::crypto::unfinished::{self, UnfinishedFolder};
use crate::model::{ErrorKind, Timestamp};
use crate::paths::Home;
use crate::service::command::BackUp;
use crate::service::failure::input;
use crate::service::{Failure, restoring};
use authros_output::Output;

/// Prefix and suffix of these files' names; the time they were written is in between.
const NAME: (&str, &str) = ("authros-", ".backup");

/// `backup --to DIR --keep N`: one more file, then at most `keep` of them.
///
/// # Errors
/// If the folder does not exist, or errors of the site; nothing is removed then.
pub async fn run(context: Context, folder: &Path, keep: Option<usize>, output: &Output) -> Result<u8, Failure> {
    let passphrase = backup_passphrase(&context.global)?;
    let folder = absolute(folder)?;
    if !folder.is_dir() {
        let shown = folder.display();
        return Err(input(format!("{shown} is not a folder; create it, or mount the disk that holds it")));
    }
    let file = folder.join(name_at(Timestamp::now()));
    let Connection { client, site } = context.connect(NEITHER).await?;
    let answer = client.ask(BackUp { file, passphrase }).await;
    Connection { client, site }.close().await;
    let mut view = answer?;
    if let Some(keep) = keep {
        let removed = remove_old(&folder, keep).map_err(|error| {
            let shown = folder.display();
            Failure::new(
                ErrorKind::Home,
                format!("the backup was written, but old ones in {shown} could not be removed: {error}"),
            )
        })?;
        view.notes.extend(removed.iter().map(|name| format!("{name} was removed; {keep} newer ones remain")));
    }
    output.result(&view, || backed_up(&view));
    Ok(0)
}

/// `authros-20270131T120000Z.backup`: names sort by time.
fn name_at(now: Timestamp) -> String {
    let digits: String =
        now.to_string().split('.').next().unwrap_or_default().chars().filter(char::is_ascii_alphanumeric).collect();
    format!("{}{}Z{}", NAME.0, digits.trim_end_matches('Z'), NAME.1)
}

/// Whether a file of this name is one of ours.
fn is_own(name: &str) -> bool {
    let Some(time) = name.strip_prefix(NAME.0).and_then(|rest| rest.strip_suffix(NAME.1)) else { return false };
    let fits = |(index, byte): (usize, u8)| match index {
        8 => byte == b'T',
        15 => byte == b'Z',
        _ => byte.is_ascii_digit(),
    };
    time.len() == 16 && time.bytes().enumerate().all(fits)
}

/// Removes all but the newest `keep` of our files; returns their names. Anything else in the folder stays.
fn remove_old(folder: &Path, keep: usize) -> std::io::Result<Vec<String>> {
    let mut own = Vec::new();
    for entry in std::fs::read_dir(folder)? {
        let entry = entry?;
        let name = entry.file_name().to_string_lossy().into_owned();
        if is_own(&name) && entry.file_type()?.is_file() {
            own.push(name);
        }
    }
    own.sort();
    own.truncate(own.len().saturating_sub(keep));
    own.iter().try_for_each(|name| std::fs::remove_file(folder.join(name)))?;
    Ok(own)
}

/// `restore --check FILE`: restores it into a folder of its own, audits every record of it, and removes it.
///
/// # Errors
/// If the file is not a backup, its passphrase is wrong, or the disk has no room for it.
pub async fn check(context: Context, file: &Path, output: &Output) -> Result<u8, Failure> {
    let passphrase = backup_passphrase(&context.global)?;
    let beside = absolute(context.home.root())?.parent().map_or_else(std::env::temp_dir, Path::to_path_buf);
    let unmade = |error: std::io::Error| {
        Failure::new(ErrorKind::Home, format!("a folder in {} cannot be created: {error}", beside.display()))
    };
    std::fs::create_dir_all(&beside).map_err(unmade)?;
    unfinished::sweep(&beside).map_err(unmade)?;
    let folder = UnfinishedFolder::new(&beside).map_err(unmade)?;
    let home: PathBuf = folder.path().join("home");
    let view = restoring::restore(file, &Home::new(home.clone()), &passphrase)?;
    output.note(&backed_up(&view));
    let drill = Context { home: Home::new(home), ..context };
    let plan = plans::audit(&drill, &AuditArguments::of_records(true))?;
    let code = verbs::run(drill, plan, output).await;
    folder.close().map_err(unmade)?;
    code
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_are_in_the_order_of_their_times_and_are_known_again() {
        let names: Vec<String> =
            [0, 1_000_000_000, 1_700_000_000].map(|seconds| name_at(Timestamp::from_seconds(seconds))).into();
        assert_eq!(
            names,
            ["authros-19700101T000000Z.backup", "authros-20010909T014640Z.backup", "authros-20231114T221320Z.backup"]
        );
        assert!(names.iter().all(|name| is_own(name)) && names.is_sorted());
    }

    #[test]
    fn only_the_oldest_of_ones_own_files_are_removed() {
        let folder = tempfile::tempdir().expect("a folder");
        let all = [
            "authros-20010909T014640Z.backup",
            "authros-20231114T221320Z.backup",
            "authros-20231115T221320Z.backup",
            "authros-20010909.backup",
            "authros-20010909T014640Z.backup.old",
            "authros-2001090xT014640Z.backup",
            "notes.txt",
        ];
        all.iter().for_each(|name| std::fs::write(folder.path().join(name), b"x").expect("written"));
        std::fs::create_dir(folder.path().join("authros-19990909T014640Z.backup")).expect("a folder of that name");
        assert_eq!(remove_old(folder.path(), 2).expect("removed"), [all[0]]);
        assert!(all[1..].iter().all(|name| folder.path().join(name).exists()));
        assert_eq!(remove_old(folder.path(), 2).expect("looked"), Vec::<String>::new());
    }
}
