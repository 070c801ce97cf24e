//! A disk of 8 MiB that is filled up and emptied again, in its own mount namespace.

use std::os::unix::fs::PermissionsExt as _;
use std::path::PathBuf;
use std::process::Command;

use super::field::{CAMERA, ODOM};
use crate::support::{Authros, Home, Running, count, free_port, skipped, system_program, text, wait_until};

/// A tmpfs visible only to its own processes.
struct Disk {
    holder: Running,
    place: PathBuf,
    home: Home,
}

impl Disk {
    fn mount(size: &str) -> Result<Self, String> {
        if !std::fs::read_to_string("/proc/self/status").is_ok_and(|about| about.contains("\nUid:\t0\t0")) {
            return Err("a tmpfs needs root".to_owned());
        }
        for program in ["unshare", "nsenter"] {
            system_program(program).ok_or_else(|| format!("no {program}"))?;
        }
        let home = Home::new();
        let place = home.root().join("disk");
        std::fs::create_dir(&place).expect("made");
        let script = "mount -t tmpfs -o size=$0,mode=0700 authros \"$1\" && echo mounted && exec sleep 600";
        let mut command = Command::new("unshare");
        command.args(["-m", "--propagation", "private", "sh", "-c", script, size]).arg(&place);
        let mut holder = Running::start(command);
        let mounted = wait_until(30, "a mount or a refusal", || {
            (holder.stdout().contains("mounted") || !holder.is_running()).then(|| holder.stdout().contains("mounted"))
        });
        if mounted { Ok(Self { holder, place, home }) } else { Err("this machine lets nobody mount".to_owned()) }
    }

    fn inside(&self, arguments: &[&str]) -> Running {
        let mut command = Command::new("nsenter");
        command.args(["-m", "-t", &self.holder.id().to_string(), "--"]).args(arguments);
        Running::start(command)
    }

    /// The program, run with access to the disk.
    fn authros(&self) -> Authros {
        let script = self.home.root().join("authros");
        let program = env!("CARGO_BIN_EXE_authros");
        let text = format!("#!/bin/sh\nexec nsenter -m -t {} -- {program} \"$@\"\n", self.holder.id());
        std::fs::write(&script, text).expect("written");
        std::fs::set_permissions(&script, std::fs::Permissions::from_mode(0o700)).expect("its mode");
        let site = self.place.join("site");
        Authros::bare(self.home.root()).with_program(&script).with(&["--home", site.to_str().expect("UTF-8")])
    }

    fn grow(&self, size: &str) {
        let place = self.place.to_str().expect("UTF-8");
        self.inside(&["mount", "-o", &format!("remount,size={size}"), place]).wait(30).expect_code(0);
    }

    /// Writes until no more fits.
    fn fill(&self) {
        let file = format!("of={}", self.place.join("filler").display());
        let outcome = self.inside(&["dd", "if=/dev/zero", &file, "bs=4k"]).wait(60);
        assert!(outcome.stderr.contains("No space left"), "{outcome}");
    }
}

#[test]
fn on_a_full_disk_nothing_acknowledged_is_lost_and_it_goes_on_when_there_is_room() {
    let disk = match Disk::mount("8m") {
        Ok(disk) => disk,
        Err(reason) => skipped!(reason),
    };
    let authros = disk.authros().with(&["--robots", "1"]);
    let authros =
        authros.with_variable("AUTHROS_DISK_RESERVE", "256KiB").with_variable("AUTHROS_CAPTURE_MEMORY", "1MiB");
    // Nobody is at the webhook all the while.
    let authros = authros
        .with_variable("AUTHROS_ALERTS_WEBHOOK", &format!("http://127.0.0.1:{}/", free_port()))
        .with_variable("AUTHROS_ALERTS_EVERY", "1")
        .with_variable("AUTHROS_ALERTS_DISK", "512KiB");
    let mut site = authros.spawn(&["serve"]);
    site.wait_for_text("serving", 60);
    authros.enrol();
    for topic in [ODOM, CAMERA] {
        authros.json(&["topics", "watch", topic]);
    }
    let life = || {
        let life = authros.json(&["status"])["life"].clone();
        assert_eq!((&life["conserved"], count(&life, "tampered")), (&true.into(), 0), "{life}");
        life
    };
    let until = |what: &str, wanted: &dyn Fn(&serde_json::Value) -> bool| {
        wait_until(90, what, || Some(life()).filter(|life| wanted(life)))
    };
    until("records are verified", &|life| count(life, "verified") >= 5);
    // A topic's first publisher on a full disk cannot be pinned, and would be quarantined.
    wait_until(90, "both topics have records", || {
        let records = |topic| authros.records(&["records", "list", "--oldest", "--topic", topic]).len();
        (records(ODOM) > 0 && records(CAMERA) > 0).then_some(())
    });
    disk.fill();
    let full = until("messages are lost and counted", &|life| count(life, "lost_in_recorder") >= 5);
    assert!(count(&full, "waiting") > 0, "what fits waits in memory: {full}");
    let told = site.stderr();
    assert!(told.contains("disk"), "the operator is told: {told}");
    let health = authros.json(&["status"])["health"].to_string();
    assert!(health.contains("disk"), "{health}");
    let alerts = || authros.json(&["alerts", "list"]);
    let has_disk = |view: &serde_json::Value, which: &str| view[which].to_string().contains("\"disk\"");
    wait_until(60, "the alert about the disk", || Some(alerts()).filter(|view| has_disk(view, "alerts")));

    disk.grow("200m");
    let view = wait_until(60, "its end", || Some(alerts()).filter(|view| has_disk(view, "over")));
    assert!(
        count(&view, "waiting") >= 2 && count(&view, "dropped") == 0,
        "nobody took them, none was given up: {view}"
    );
    let queue =
        std::fs::metadata(format!("/proc/{}/root{}", disk.holder.id(), disk.place.join("site/alerts.queue").display()));
    assert!(queue.expect("written once there was room").len() > 0);
    let before = count(&full, "verified");
    until("it goes on by itself", &|life| count(life, "verified") >= before + 20);
    for topic in [ODOM, CAMERA] {
        authros.json(&["topics", "unwatch", topic]);
    }
    let end = until("all is verified", &|life| count(life, "pending") == 0 && count(life, "waiting") == 0);
    let lost = count(&end, "lost_in_recorder");
    assert_eq!(count(&end, "captured"), count(&end, "verified") + lost, "{end}");
    let gaps = wait_until(60, "every loss is told of", || {
        let gaps = authros.records(&["records", "list", "--oldest", "--kind", "gap", "--state", "verified"]);
        let opened: Vec<_> = gaps.iter().map(|gap| authros.json(&["records", "open", &text(gap, "id")])).collect();
        (opened.iter().map(|gap| count(&gap["message"], "lost")).sum::<u64>() == lost).then_some(opened)
    });
    assert!(gaps.iter().any(|gap| gap["message"]["reason"] == "disk full"), "{gaps:?}");
    let records = authros.records(&["records", "list", "--oldest"]);
    assert_eq!(records.len() as u64, count(&end, "verified"), "every acknowledged record is there");
    for record in [&records[0], &records[records.len() - 1]] {
        assert_eq!(authros.json(&["records", "check", &text(record, "id")])["verdict"], "verified");
    }
    site.stop("TERM", 30).expect_code(0);
}

#[test]
fn on_a_full_disk_who_only_looks_is_answered_or_told_so_in_true_words() {
    let disk = match Disk::mount("16m") {
        Ok(disk) => disk,
        Err(reason) => skipped!(reason),
    };
    let authros = disk.authros().with(&["--robots", "1"]).with_variable("AUTHROS_DISK_RESERVE", "256KiB");
    authros.enrol();
    authros.capture(&[ODOM], 2);
    disk.fill();
    for looking in
        [&["status"][..], &["records", "list", "--oldest"], &["topics", "list"], &["grant", "list"], &["audit"]]
    {
        let outcome = authros.run(looking);
        let words = format!("{}{}", outcome.stdout, outcome.stderr);
        let told = words.contains("full") && words.contains("free some space") && !words.contains("automatically");
        println!("{looking:?}: {:?} {}", outcome.code, words.lines().last().unwrap_or_default());
        assert!(outcome.code == Some(0) || told, "{looking:?}: {outcome}");
    }
    disk.grow("64m");
    authros.run(&["audit", "--deep"]).expect_code(0);
    assert_eq!(authros.records(&["records", "list", "--oldest"]).len(), 2);
}

#[test]
fn what_waited_for_a_full_disk_and_died_with_the_process_is_told_at_the_next_start() {
    let home = Home::new();
    let authros = home.authros().with(&["--robots", "1"]);
    authros.enrol();
    authros.capture(&[ODOM], 2);
    // More than any disk has free: no further record is acknowledged.
    let full = authros.with_variable("AUTHROS_DISK_RESERVE", "900000GiB");
    let site = full.serve(&home);
    full.json(&["topics", "watch", ODOM]);
    let life = |of: &Authros| of.json(&["status"])["life"].clone();
    wait_until(60, "messages wait in memory", || (count(&life(&full), "waiting") >= 20).then_some(()));
    let before = life(&full);
    // Noted every two seconds at the latest.
    std::thread::sleep(std::time::Duration::from_secs(5));
    site.stop("KILL", 10);

    let site = authros.serve(&home);
    let waited = count(&before, "waiting");
    let after = wait_until(60, "what died is counted", || {
        Some(life(&authros)).filter(|life| count(life, "lost_in_recorder") >= waited)
    });
    assert_eq!(after["conserved"], true, "{after}");
    authros.json(&["topics", "unwatch", ODOM]);
    let lost = count(&after, "lost_in_recorder");
    let gaps = wait_until(60, "a gap record of it", || {
        let gaps = authros.records(&["records", "list", "--oldest", "--kind", "gap", "--state", "verified"]);
        let opened: Vec<_> = gaps.iter().map(|gap| authros.json(&["records", "open", &text(gap, "id")])).collect();
        (opened.iter().map(|gap| count(&gap["message"], "lost")).sum::<u64>() >= lost).then_some(opened)
    });
    assert!(gaps.iter().any(|gap| gap["message"]["reason"] == "end"), "{gaps:?}");
    site.stop("KILL", 10);

    // Once is enough, also after a second death.
    let site = authros.serve(&home);
    let again = wait_until(60, "all is verified", || Some(life(&authros)).filter(|life| count(life, "pending") == 0));
    assert_eq!((count(&again, "lost_in_recorder"), &again["conserved"]), (lost, &true.into()), "{again}");
    site.stop("TERM", 30).expect_code(0);
    authros.run(&["audit", "--deep"]).expect_code(0);
}
