//! `bag follow`: what a recorder writes is sealed while it writes, each message once, whatever happens meanwhile, and its
//! files are proven.
#![allow(clippy::expect_used, clippy::panic, reason = "a test fails by panicking")]

use crate::support;

use std::fs;
use std::path::{Path, PathBuf};
use std::process::Command;
use std::time::{Duration, Instant};

use authros::ros::recording::BESIDE;
use serde_json::Value;
use support::ros2::{database_recorder, others_can_read, read_by_others, recorder};
use support::{Authros, Home, Outcome, Running, count, list, skipped, text, wait_until};

use crate::audit::{fill, on_small_disk};
use crate::evidence::{by_the_second, expect_agreement, unzipped, verified};

const REFUSED: i32 = 5;
const TAMPERED: i32 = 6;
const INCOMPLETE: i32 = 8;

/// The fields of a message that go through a record and come out again, one line a message.
fn lines(recordings: &[PathBuf]) -> Vec<String> {
    let fields = ["topic", "type", "definition", "schema", "encoding", "metadata", "logged", "published", "sequence"];
    let line = |message: &Value| {
        let told = fields.map(|field| message[field].to_string());
        format!("{} {}", told.join(" "), message["sha256"])
    };
    let mut lines: Vec<String> =
        recordings.iter().flat_map(|path| read_by_others(path)).map(|message| line(&message)).collect();
    lines.sort_unstable();
    lines
}

fn recordings(folder: &Path) -> Vec<PathBuf> {
    let entries = fs::read_dir(folder).expect("listed").map(|entry| entry.expect("an entry").path());
    let is_recording = |path: &PathBuf| path.extension().is_some_and(|end| end == "mcap" || end == "db3");
    let mut found: Vec<PathBuf> = entries.filter(is_recording).collect();
    // `run_9` is before `run_10`.
    found.sort_by_key(|path| (path.as_os_str().len(), path.clone()));
    found
}

fn utf8(path: &Path) -> &str {
    path.to_str().expect("UTF-8")
}

fn follower(authros: &Authros, folder: &Path, options: &[&str]) -> Running {
    authros.with(&["--json"]).spawn(&[&["bag", "follow", utf8(folder)], options].concat())
}

/// Kills a follower this often within these seconds, and begins it again each time.
fn killed_and_begun_again(
    authros: &Authros,
    folder: &Path,
    options: &[&str],
    mut following: Running,
    (seconds, kills): (u64, u32),
) -> Running {
    for _ in 0..kills {
        std::thread::sleep(Duration::from_secs(seconds) / (kills + 1));
        following.signal("KILL");
        drop(following.wait(60));
        following = follower(authros, folder, options);
    }
    following
}

fn sum(view: &Value, field: &str) -> u64 {
    list(view, "files").iter().map(|file| count(file, field)).sum()
}

/// A proof with the file that it is about: both verifiers say the same of it.
fn with_recording(proof: &Path, recording: &Path) -> (Outcome, Outcome) {
    let mut command = Command::new(env!("CARGO_BIN_EXE_authros"));
    command.env_clear().args(["evidence", "verify"]).arg(proof).arg("--json").arg("--recording").arg(recording);
    let ours = Running::start(command).wait(60);
    let theirs = by_the_second(proof, None, &["--recording", utf8(recording)]);
    assert_eq!(ours.code, theirs.code, "{ours}\n{theirs}");
    let (own, other) = (ours.document()["recording"].clone(), theirs.document()["recording"].clone());
    for field in ["standing", "record", "name", "bytes", "chunks", "differing"] {
        assert_eq!(own[field], other[field], "{field}: {own} {other}");
    }
    (ours, theirs)
}

fn expect_proven(folder: &Path, view: &Value) {
    let files = list(view, "files");
    assert_eq!(files.len(), recordings(folder).len(), "{view}");
    for (at, (file, recording)) in files.iter().zip(recordings(folder)).enumerate() {
        let proof = PathBuf::from(format!("{}.authros", recording.display()));
        assert_eq!((text(file, "proof"), &file["is_closed"]), (utf8(&proof).to_owned(), &true.into()), "{file}");
        let (outcome, _) = with_recording(&proof, &recording);
        let told = outcome.expect_code(INCOMPLETE).document();
        // A home's own chain proves nothing against it; the file is as it is stated.
        assert_eq!(text(&told["recording"], "standing"), "proven", "{told}");
        assert_eq!(count(&told["recording"], "chunks"), count(file, "chunks"), "{file}");
        if at == 0 {
            let trust = folder.with_extension("toml");
            fs::write(&trust, unzipped(&proof, "trust.toml")).expect("written");
            verified(&proof, Some(&trust)).expect_code(INCOMPLETE);
            expect_agreement(&proof, Some(&trust));
        }
        // Without a compression a message is where it was; one of its bytes is another one.
        let mut bytes = fs::read(&recording).expect("read");
        let middle = bytes.len() / 2;
        bytes[middle] ^= 1;
        let altered = folder.with_extension("altered");
        fs::write(&altered, bytes).expect("written");
        let (outcome, _) = with_recording(&proof, &altered);
        let told = outcome.expect_code(TAMPERED).document();
        assert_eq!(text(&told["recording"], "standing"), "refused", "{told}");
    }
    let other = with_recording(&PathBuf::from(text(&files[0], "proof")), &recordings(folder)[1]).0;
    other.expect_code(TAMPERED);
}

/// Everything that came out is everything that was recorded, once.
fn expect_all_once(authros: &Authros, folder: &Path, messages: u64) {
    let records = authros.json(&["status"]);
    let back = folder.with_extension("back.mcap");
    let view = authros.json_within(600, &["bag", "export", "--mcap", utf8(&back)]);
    assert_eq!(count(&view, "messages"), messages, "{view} {records}");
    assert_eq!(lines(&[back]), lines(&recordings(folder)));
}

#[test]
fn what_is_recorded_is_sealed_while_it_is_recorded_each_message_once_and_its_files_are_proven() {
    if !others_can_read() {
        skipped!("no mcap of Python in target/peers (tests/run installs it)");
    }
    let (seconds, rate, split, kills) = if support::long() { (600, 2_000, 30, 20) } else { (12, 300, 3, 4) };
    let home = Home::new();
    let authros = home.authros().with(&["--robots", "0"]);
    authros.enrol();
    let folder = home.root().join("run");
    let options = ["--until-closed", "--tag", "mission=harbour"];
    let mut following = follower(&authros, &folder, &options);
    // The recorder makes the folder, as rosbag2 does: it refuses one that is there.
    following.wait_for_text("to appear", 120);
    let recording = recorder(&folder, seconds, rate, split, "zstd");
    following = killed_and_begun_again(&authros, &folder, &options, following, (seconds, kills));
    let recorded = recording.wait(seconds + 120).expect_code(0).document();
    let view = following.wait(seconds + 600).expect_code(0).document();
    let messages = count(&recorded, "messages");
    // Two metadata records of rosbag2 at most in each file.
    let beside = count(&recorded, "files") + 1;
    assert_eq!(sum(&view, "found"), messages + beside, "{view}");
    assert_eq!((sum(&view, "sealed") + sum(&view, "already"), sum(&view, "lost")), (messages + beside, 0), "{view}");
    assert!(list(&view, "files").iter().all(|file| list(file, "damages").is_empty()), "{view}");
    expect_proven(&folder, &view);
    if support::long() {
        tell_processor(&folder);
        return;
    }
    expect_all_once(&authros, &folder, messages);
    // What was followed is not sealed again by an import, nor by following it again.
    let imported = authros.json_within(240, &["bag", "import", utf8(&recordings(&folder)[0])]);
    assert_eq!((count(&imported, "imported"), count(&imported, "attachments") > 0), (0, true), "{imported}");
    let again = follower(&authros, &folder, &options).wait(240).expect_code(0).document();
    assert_eq!((sum(&again, "sealed"), sum(&again, "already")), (0, messages + beside), "{again}");
    let tagged = authros.records(&["records", "list", "--oldest", "--tag", "mission=harbour", "--topic", "/numbers"]);
    assert_eq!(tagged.len() as u64, messages.div_ceil(3));
}

/// Topic, time and SHA-256 of every message of a recording of others.
fn contents(recording: &Path) -> Vec<String> {
    let line =
        |message: &Value| format!("{} {} {}", text(message, "topic"), message["logged"], text(message, "sha256"));
    let mut lines: Vec<String> = read_by_others(recording).iter().map(line).collect();
    lines.sort_unstable();
    lines
}

#[test]
fn a_database_is_sealed_when_it_is_closed_and_its_recorder_notices_nothing() {
    if !others_can_read() {
        skipped!("no mcap of Python in target/peers (tests/run installs it)");
    }
    // What comes back is compared line by line: a million lines would take longer than the recording.
    let (seconds, rate, split, kills) = if support::long() { (600, 400, 30, 20) } else { (15, 200, 5, 3) };
    let home = Home::new();
    let authros = home.authros().with(&["--robots", "0"]);
    authros.enrol();
    let folder = home.root().join("run");
    let options = ["--until-closed"];
    let mut following = follower(&authros, &folder, &options);
    following.wait_for_text("to appear", 120);
    let recording = database_recorder(&folder, seconds, rate, split);
    following.wait_for_text("is sealed once it is closed", 120);
    assert!(!following.stderr().contains("following run_0.db3"), "it is still recorded: {}", following.stderr());
    following = killed_and_begun_again(&authros, &folder, &options, following, (seconds, kills));
    // A lock of somebody else's would have ended it.
    let recorded = recording.wait(seconds + 120).expect_code(0).document();
    let outcome = following.wait(seconds + 600).expect_code(0);
    let view = outcome.document();
    let (messages, files) = (count(&recorded, "messages"), count(&recorded, "files"));
    // One row of metadata in each.
    let all = messages + files;
    assert_eq!((sum(&view, "found"), sum(&view, "sealed") + sum(&view, "already")), (all, all), "{outcome}");
    expect_proven(&folder, &view);
    let names: Vec<String> =
        fs::read_dir(&folder).expect("listed").map(|entry| text_of(&entry.expect("an entry").file_name())).collect();
    assert_eq!(names.len() as u64, 2 * files + 1, "nothing but files, proofs and the description: {names:?}");
    let sent = fs::read_to_string(folder.with_extension("sent")).expect("read");
    let mut sent: Vec<String> = sent.lines().map(str::to_owned).collect();
    sent.sort_unstable();
    let back = folder.with_extension("back.mcap");
    authros.json_within(600, &["bag", "export", "--mcap", utf8(&back)]);
    assert_eq!(contents(&back), sent);
    let again = follower(&authros, &folder, &options).wait(240).expect_code(0).document();
    assert_eq!((sum(&again, "sealed"), sum(&again, "already")), (0, all), "{again}");
    let imported = authros.json_within(240, &["bag", "import", utf8(&folder)]);
    assert_eq!((count(&imported, "imported"), count(&imported, "already")), (0, messages), "{imported}");
}

fn text_of(name: &std::ffi::OsStr) -> String {
    name.to_string_lossy().into_owned()
}

#[test]
fn a_sealed_file_that_changes_later_is_told_by_every_run_until_somebody_decides() {
    if !others_can_read() {
        skipped!("no mcap of Python in target/peers (tests/run installs it)");
    }
    let home = Home::new();
    let _site = home.authros().with(&["--robots", "0"]).serve(&home);
    let authros = home.authros();
    authros.enrol();
    let folder = home.root().join("run");
    recorder(&folder, 2, 200, 1, "zstd").wait(120).expect_code(0);
    fs::write(folder.join("notmcap.mcap"), "no recording at all").expect("written");
    let mut following = follower(&authros, &folder, &[]);
    let [first, second] = [recordings_of(&folder, "run_0"), recordings_of(&folder, "run_1")];
    let proof = PathBuf::from(format!("{}.authros", second.display()));
    wait_until(120, "both proofs", || {
        (proof.exists() && following.stderr().contains("run_0.mcap: its proof")).then_some(())
    });
    assert_eq!(following.stderr().matches("notmcap.mcap: it is not an MCAP file").count(), 1, "{}", following.stderr());
    // While it is followed, and then while it is not: a byte in its middle, and one more at its end.
    let mut bytes = fs::read(&first).expect("read");
    let middle = bytes.len() / 2;
    bytes[middle] ^= 1;
    fs::write(&first, &bytes).expect("altered");
    following.wait_for_text("run_0.mcap: it has changed since it was sealed at 20", 60);
    let told = following.stop("INT", 120).expect_code(TAMPERED).document();
    assert_eq!(list(&told, "files").iter().filter(|file| file["is_altered"] == true).count(), 1, "{told}");
    let grown = [fs::read(&second).expect("read"), vec![0]].concat();
    fs::write(&second, grown).expect("longer");
    // A file of another inode in the place of the first.
    fs::remove_file(&first).expect("removed");
    fs::write(&first, &bytes).expect("written");
    let next = follower(&authros, &folder, &["--until-closed"]).wait(240).expect_code(TAMPERED);
    assert!(next.stderr.contains("run_1.mcap: it has changed since it was sealed at 20"), "{next}");
    let view = next.document();
    for file in list(&view, "files").iter().filter(|file| text(file, "file").starts_with("run_")) {
        let note = file["notes"][0].as_str().unwrap_or_default();
        assert!(note.starts_with("it has changed since it was sealed at 20"), "{next}");
        assert!(note.contains(&format!("move {}.authros away", text(file, "file"))), "{next}");
    }
    assert_eq!(sum(&view, "sealed"), 0, "{next}");
    let (outcome, _) = with_recording(&proof, &second);
    outcome.expect_code(TAMPERED);
    // Decided: it is sealed as it is now.
    fs::rename(format!("{}.authros", first.display()), home.root().join("former.authros")).expect("moved");
    let last = follower(&authros, &folder, &["--until-closed"]).wait(240).document();
    let sealed = list(&last, "files").into_iter().find(|file| text(file, "file") == "run_0.mcap").expect("there");
    assert!(count(&sealed, "sealed") > 0 && sealed["proof"].is_string(), "{last}");
}

fn recordings_of(folder: &Path, name: &str) -> PathBuf {
    folder.join(name).with_extension("mcap")
}

/// Seals a copy of a recording in a profile of its own.
struct Copied {
    authros: Authros,
    folder: PathBuf,
}

impl Copied {
    fn new(home: &Home, recorded: &Path, name: &str) -> Self {
        let (authros, folder) = (home.profile(name), home.root().join(name));
        authros.enrol();
        fs::create_dir(&folder).expect("a folder");
        for entry in fs::read_dir(recorded).expect("listed") {
            let path = entry.expect("an entry").path();
            fs::copy(&path, folder.join(path.file_name().expect("a name"))).expect("copied");
        }
        Self { authros, folder }
    }

    /// Messages imported and found sealed, and what was imported beside them.
    fn import(&self, path: &Path) -> [u64; 3] {
        let view = self.authros.json_within(240, &["bag", "import", utf8(path)]);
        assert!(list(&view, "damages").is_empty(), "{view}");
        let beside = list(&view, "topics").into_iter().find(|topic| text(topic, "topic") == BESIDE);
        [count(&view, "imported"), count(&view, "already"), beside.map_or(0, |topic| count(&topic, "imported"))]
    }

    /// What was sealed and found sealed, what is beside the messages among it.
    fn follow(&self, options: &[&str]) -> [u64; 2] {
        let options = [&["--until-closed"], options].concat();
        let view = follower(&self.authros, &self.folder, &options).wait(240).expect_code(0).document();
        ["sealed", "already"].map(|field| sum(&view, field))
    }
}

#[test]
fn a_folder_that_is_followed_and_imported_is_sealed_once_whichever_is_first() {
    if !others_can_read() {
        skipped!("no mcap of Python in target/peers (tests/run installs it)");
    }
    let home = Home::new();
    let _site = home.authros().with(&["--robots", "0"]).serve(&home);
    let run = home.root().join("run");
    let recorded = recorder(&run, 4, 300, 2, "zstd").wait(120).expect_code(0).document();
    // The metadata records of its files; an import has metadata.yaml, too.
    let (messages, beside) = (count(&recorded, "messages"), count(&recorded, "files") + 1);

    let one = Copied::new(&home, &run, "followed");
    assert_eq!(one.follow(&[]), [messages + beside, 0]);
    assert_eq!(one.import(&one.folder), [0, messages, 1], "only metadata.yaml is new");
    assert_eq!(one.import(&one.folder), [0, messages, 0]);
    expect_all_once(&one.authros, &one.folder, messages);

    let one = Copied::new(&home, &run, "imported");
    assert_eq!(one.import(&one.folder), [messages, 0, beside + 1]);
    assert_eq!(one.follow(&[]), [0, messages + beside]);
    let [new, known, _] = one.import(&recordings(&one.folder)[0]);
    assert!(new == 0 && known > 0 && known < messages, "{known}: a file of it alone");
    expect_all_once(&one.authros, &one.folder, messages);

    let one = Copied::new(&home, &run, "alone");
    let [new, ..] = one.import(&recordings(&one.folder)[1]);
    let [rest, known, _] = one.import(&one.folder);
    assert_eq!((known, new + rest), (new, messages), "a file of it was imported alone");

    // Only some topics were followed; the others are not taken for sealed.
    let one = Copied::new(&home, &run, "chosen");
    let numbers = messages.div_ceil(3);
    assert_eq!(one.follow(&["--topic", "/numbers"]), [numbers, 0]);
    assert_eq!(one.import(&one.folder), [messages - numbers, numbers, beside + 1]);
    expect_all_once(&one.authros, &one.folder, messages);
}

#[test]
fn an_import_goes_on_where_a_follower_was_killed() {
    if !others_can_read() {
        skipped!("no mcap of Python in target/peers (tests/run installs it)");
    }
    let home = Home::new();
    let serve = || home.authros().with(&["--robots", "0"]).serve(&home);
    let (site, authros) = (serve(), home.authros());
    authros.enrol();
    let folder = home.root().join("run");
    let mut following = follower(&authros, &folder, &["--until-closed"]);
    following.wait_for_text("to appear", 120);
    // One file, so that it is left in its middle.
    let recording = recorder(&folder, 16, 300, 60, "lz4");
    let one = Copied { authros, folder };
    let sealed = || one.authros.records(&["records", "list", "--oldest", "--topic", "/numbers"]).len();
    wait_until(120, "records", || (sealed() > 50).then_some(()));
    site.stop("KILL", 60);
    following.signal("KILL");
    drop(following.wait(60));
    let _site = serve();
    let messages = count(&recording.wait(120).expect_code(0).document(), "messages");
    let [new, known, beside] = one.import(&one.folder);
    // Its last metadata record and metadata.yaml; the first was sealed before the messages.
    assert_eq!(beside, 2);
    assert!(new > 0 && known > 0 && new + known == messages, "{new} and {known} of {messages}");
    assert_eq!(one.follow(&[]), [0, messages + 2]);
    expect_all_once(&one.authros, &one.folder, messages);
}

/// Prints the processor's time of following and of importing the same files, a message.
#[allow(clippy::print_stdout, reason = "a figure of the long run")]
fn tell_processor(folder: &Path) {
    let some = folder.with_extension("some");
    fs::create_dir(&some).expect("a folder");
    for file in recordings(folder).iter().take(4) {
        fs::copy(file, some.join(file.file_name().expect("a name"))).expect("copied");
    }
    fs::write(some.join("metadata.yaml"), "").expect("written");
    let seconds = |acts: &[&[&str]]| -> f64 {
        let home = Home::new();
        let authros = home.authros().with(&["--robots", "0"]);
        authros.enrol();
        let (script, program) = ("TIMEFORMAT='cpu %U %S'; time \"$@\"", authros.program().to_owned());
        let timed = authros.with_program(Path::new("/bin/bash")).with_prefix(&["-c", script, "timed", utf8(&program)]);
        let spent = |act: &&[&str]| -> f64 {
            let outcome = timed.spawn(act).wait(1200).expect_code(0);
            let line = outcome.stderr.lines().rev().find_map(|line| line.strip_prefix("cpu ")).expect("its time");
            line.split(' ').map(|number| number.parse::<f64>().expect("seconds")).sum()
        };
        acts.iter().map(spent).sum()
    };
    let messages = f64::from(u32::try_from(lines(&recordings(&some)).len()).expect("not that many"));
    let followed = seconds(&[&["bag", "follow", utf8(&some), "--until-closed"]]);
    let files = recordings(&some);
    let imports: Vec<[&str; 3]> = files.iter().map(|file| ["bag", "import", utf8(file)]).collect();
    let imported = seconds(&imports.iter().map(|act| &act[..]).collect::<Vec<_>>());
    let each = |seconds: f64| seconds * 1e6 / messages;
    println!(
        "{messages} messages: followed {:.0} us of processor each, imported {:.0}",
        each(followed),
        each(imported)
    );
}

/// A served home, a recorder that goes on, and a follower of its folder that has sealed something.
fn under_way(home: &Home, authros: &Authros, how: &str, options: &[&str]) -> (PathBuf, Running, Running) {
    let folder = home.root().join(format!("run_{how}"));
    let recording = recorder(&folder, 600, 200, 600, how);
    wait_until(60, "a folder", || folder.exists().then_some(()));
    let mut following = follower(authros, &folder, options);
    following.wait_for_text("following run", 120);
    let begun = || authros.records(&["records", "list", "--oldest"]).first().map(|_| ());
    wait_until(120, "a record", begun);
    (folder, recording, following)
}

#[test]
fn two_followers_a_file_that_shrinks_and_a_folder_that_goes_are_told_and_nothing_is_sealed_twice() {
    if !others_can_read() {
        skipped!("no mcap of Python in target/peers (tests/run installs it)");
    }
    let home = Home::new();
    let _site = home.authros().with(&["--robots", "0"]).serve(&home);
    let authros = home.authros();
    authros.enrol();
    let (folder, recording, following) = under_way(&home, &authros, "unchunked", &[]);
    for other in [folder.clone(), folder.join("."), home.root().to_owned(), folder.join("below")] {
        let told = authros.fails(REFUSED, &["bag", "follow", utf8(&other)]);
        assert!(told.contains("already being followed"), "{told}");
    }
    let told = authros.fails(REFUSED, &["bag", "import", utf8(&recordings(&folder)[0])]);
    assert!(told.contains("is being followed and sealed now") && told.contains("end the follower"), "{told}");
    recording.stop("KILL", 60);
    let file = recordings(&folder).remove(0);
    // Less than the follower has read, however far behind the recorder it is.
    fs::OpenOptions::new().write(true).open(&file).and_then(|file| file.set_len(2_048)).expect("shorter");
    wait_until(60, "words about it", || following.stderr().contains("bytes left of the").then_some(()));
    let told = following.stop("INT", 120).expect_code(TAMPERED);
    assert_eq!(list(&told.document(), "files")[0]["is_altered"], true, "{told}");
    let sealed = sum(&told.document(), "sealed");
    assert!(sealed > 0, "{told}");
    // It is shorter than what was sealed also for the next run, and nothing of it is sealed again.
    let next = follower(&authros, &folder, &["--until-closed"]).wait(120).expect_code(TAMPERED).document();
    assert_eq!(sum(&next, "sealed"), 0, "{next}");

    let (folder, recording, following) = under_way(&home, &authros, "none", &[]);
    fs::remove_dir_all(&folder).expect("removed");
    let gone = following.wait(120).expect_code(INCOMPLETE);
    assert!(gone.stderr.contains("is gone") && sum(&gone.document(), "sealed") > 0, "{gone}");
    recording.stop("KILL", 60);
}

#[test]
#[allow(clippy::print_stdout, reason = "how soon it was")]
fn a_recording_whose_recorder_was_killed_is_sealed_as_far_as_it_goes() {
    if !others_can_read() {
        skipped!("no mcap of Python in target/peers (tests/run installs it)");
    }
    let home = Home::new();
    let _site = home.authros().with(&["--robots", "0"]).serve(&home);
    let authros = home.authros();
    authros.enrol();
    let (folder, recording, following) = under_way(&home, &authros, "lz4", &["--until-closed"]);
    let file = recordings(&folder).remove(0);
    // Sealed within a second of being on the disk; a busy machine, which also lists the records, gets twenty.
    let sealed = || authros.records(&["records", "list", "--oldest", "--topic", "/numbers"]).len();
    let (length, before) = (fs::metadata(&file).expect("there").len(), sealed());
    wait_until(60, "one more chunk", || (fs::metadata(&file).expect("there").len() > length).then_some(()));
    let since = Instant::now();
    wait_until(20, "its records", || (sealed() > before).then_some(()));
    println!("a chunk's records were listed {:?} after it was written", since.elapsed());
    recording.stop("KILL", 60);
    let told = following.wait(240).expect_code(INCOMPLETE);
    let view = told.document();
    let one = &list(&view, "files")[0];
    assert_eq!((&one["is_closed"], one["proof"].is_string()), (&false.into(), true), "{told}");
    assert!(told.stderr.contains("was not closed") && count(one, "sealed") > 100, "{told}");
    let proof = PathBuf::from(text(one, "proof"));
    let (outcome, _) = with_recording(&proof, &file);
    assert_eq!(text(&outcome.document()["recording"], "standing"), "proven", "{outcome}");
    assert!(count(one, "chunks") > 1, "{one}");
}

#[test]
fn a_full_disk_of_the_home_is_waited_for_and_nothing_is_lost() {
    if !others_can_read() {
        skipped!("no mcap of Python in target/peers (tests/run installs it)");
    }
    let home = Home::new();
    let Some((_site, authros)) = on_small_disk(&home) else { skipped!("no tmpfs of its own (unshare -m)") };
    authros.enrol();
    let full = Path::new(&authros.arguments(&[])[1]).join("fill");
    let folder = home.root().join("run");
    let mut following = follower(&authros, &folder, &["--until-closed"]);
    following.wait_for_text("to appear", 120);
    let recording = recorder(&folder, 12, 100, 4, "lz4");
    let begun = || authros.records(&["records", "list", "--oldest", "--topic", "/numbers"]).first().map(|_| ());
    wait_until(120, "a record", begun);
    fill(&full);
    let recorded = recording.wait(120).expect_code(0).document();
    // The end of the recording is on the disk, and not in the home.
    std::thread::sleep(Duration::from_secs(3));
    following.expect_running();
    assert!(following.stderr().contains("is full") && following.stderr().contains("continues automatically"));
    fs::remove_file(&full).expect("space again");
    let view = following.wait(240).expect_code(0).document();
    let messages = count(&recorded, "messages");
    assert_eq!(sum(&view, "found"), messages + count(&recorded, "files") + 1, "{view}");
    expect_all_once(&authros, &folder, messages);
}

#[test]
fn the_package_of_ros_2_starts_the_program_without_what_ros_adds() {
    let Some(python) = support::system_program("python3") else { skipped!("no python3") };
    let package = concat!(env!("CARGO_MANIFEST_DIR"), "/packaging/ros2/authros");
    let started = |program: &str, entry: &str| {
        let mut command = Command::new(&python);
        let code = format!("import sys; from authros.program import {entry}; sys.exit({entry}())");
        command.args(["-B", "-c", &code, "--help", "--ros-args", "-r", "__node:=follow"]);
        command.env_clear().env("PYTHONPATH", package).env("AUTHROS_PROGRAM", program);
        Running::start(command).wait(60)
    };
    let commands = [
        ("follow", "--until-closed"),
        ("agent", "<ENROLMENT>"),
        ("serve", "--detach"),
        ("any_command", "The operator console"),
    ];
    for (entry, said) in commands {
        let told = started(env!("CARGO_BIN_EXE_authros"), entry).expect_code(0);
        assert!(told.stdout.contains(said), "{entry}: {told}");
    }
    let told = started("/nowhere/authros", "follow").expect_code(3);
    assert!(told.stderr.contains("AUTHROS_PROGRAM"), "{told}");
}
