//! Paths in forms are completed as in a shell, and records are exported where they were asked for.

use super::*;
use crate::app::PathKind;
use crate::app::completion::{Candidate, Found, Sought};

fn at_file() -> Robot {
    let mut robot = Robot::at_work(true);
    robot.state.settings.directory = "/home/operator".into();
    robot.state.settings.home = Some("/home/operator".into());
    robot.types("6");
    robot.site_answers(true);
    robot.types("L");
    robot.presses(Key::Enter);
    robot
}

/// Presses tab; what is looked for now.
fn tab(robot: &mut Robot) -> Sought {
    robot.presses(Key::Tab);
    match robot.effects.pop() {
        Some(Effect::FindPaths(sought)) => sought,
        other => panic!("nothing is looked for: {other:?}"),
    }
}

fn found(names: &[&str]) -> Found {
    let candidate =
        |name: &&str| Candidate { name: name.trim_end_matches('/').to_owned(), folder: name.ends_with('/') };
    Found { names: names.iter().map(candidate).collect(), more: false }
}

/// Presses tab in a folder with these names.
fn completes(robot: &mut Robot, names: &[&str]) -> String {
    let sought = tab(robot);
    let names: Vec<&str> = names.iter().copied().filter(|name| name.starts_with(&sought.begun)).collect();
    robot.act(Action::PathsFound(sought, Ok(found(&names))));
    form(robot).text(1).to_owned()
}

fn form(robot: &Robot) -> &crate::app::Form {
    match robot.state.popups.last() {
        Some(Popup::Form(_, form)) => form,
        other => panic!("no form, but {other:?}"),
    }
}

#[test]
fn tab_goes_as_far_as_all_names_agree_and_then_lists_them() {
    let mut robot = at_file();
    robot.types("ke");
    let folder = ["keys/", "key-old.pem", "key-new.pem", "notes"];
    assert_eq!(completes(&mut robot, &folder), "key");
    assert!(form(&robot).told.is_empty());
    assert_eq!(completes(&mut robot, &folder), "key");
    assert_eq!(form(&robot).told, ["keys/  key-old.pem  key-new.pem"]);
    robot.types("s");
    assert!(form(&robot).told.is_empty(), "typing takes the list away");
    assert_eq!(completes(&mut robot, &folder), "keys/");
    let sought = tab(&mut robot);
    assert_eq!((sought.folder.to_str(), sought.begun.as_str()), (Some("/home/operator/keys/"), ""));
    robot.act(Action::PathsFound(sought, Ok(found(&["sm2.pem"]))));
    assert_eq!(form(&robot).text(1), "keys/sm2.pem");
    let sought = tab(&mut robot);
    assert_eq!(form(&robot).focus, 1);
    robot.act(Action::PathsFound(sought, Ok(found(&["sm2.pem"]))));
    assert_eq!(form(&robot).focus, 2, "a path that is complete leads on to the next line");
}

#[test]
fn the_folder_that_is_read_is_the_one_that_is_meant() {
    for (typed, folder, begun) in [
        ("", "/home/operator/", ""),
        ("a", "/home/operator/", "a"),
        ("~", "/home/operator", ""),
        ("~/keys/s", "/home/operator/keys/", "s"),
        ("/", "/", ""),
        ("/et", "/", "et"),
        ("/etc/ssl/.c", "/etc/ssl/", ".c"),
        ("../b", "/home/operator/../", "b"),
        ("~bob/k", "/home/operator/~bob/", "k"),
    ] {
        let mut robot = at_file();
        robot.types(typed);
        let sought = tab(&mut robot);
        assert_eq!((sought.folder.to_str(), sought.begun.as_str()), (Some(folder), begun), "{typed}");
        assert_eq!((sought.typed.as_str(), sought.kind), (typed, PathKind::File));
    }
    let mut robot = at_file();
    robot.types("~");
    assert_eq!(completes(&mut robot, &["keys/", "notes"]), "~/", "what is below it has a slash");
}

#[test]
fn names_that_cannot_be_typed_are_listed_clean_and_never_completed() {
    let mut robot = at_file();
    let hostile = "evil\u{1b}[2J\u{202e}";
    assert_eq!(completes(&mut robot, &[hostile]), "");
    completes(&mut robot, &[hostile]);
    let told = form(&robot).told.join("\n");
    assert!(told.contains("evil\u{fffd}[2J\u{fffd}") && told.contains("cannot be typed"), "{told}");
    assert!(!told.contains('\u{1b}'));
    assert_eq!(completes(&mut robot, &[hostile, "good"]), "good", "the others are");
}

#[test]
fn what_is_not_there_is_said_and_a_late_answer_changes_nothing() {
    let mut robot = at_file();
    robot.types("nope");
    assert_eq!(completes(&mut robot, &[]), "nope");
    assert!(form(&robot).told[0].contains("nothing in /home/operator/ begins with 'nope'"), "{:?}", form(&robot).told);
    let sought = tab(&mut robot);
    robot.types("x");
    robot.act(Action::PathsFound(sought, Ok(found(&["nope.pem"]))));
    assert_eq!(form(&robot).text(1), "nopex");
    let sought = tab(&mut robot);
    robot.act(Action::PathsFound(sought, Err("/home/operator cannot be read: denied".to_owned())));
    assert!(form(&robot).told[0].contains("cannot be read"));
    let sought = tab(&mut robot);
    robot.act(Action::PathsFound(sought, Ok(Found { more: true, ..found(&["nopex1", "nopex2"]) })));
    assert_eq!(form(&robot).text(1), "nopex", "of what was not read nothing is known");
    assert!(form(&robot).told.last().is_some_and(|line| line.contains("more than was read")));
}

#[test]
fn letters_typed_on_a_choice_do_not_vanish_without_a_word() {
    let mut robot = Robot::at_work(true);
    robot.types("6");
    robot.site_answers(true);
    robot.types("L/keys");
    assert!(
        robot.form_error().is_some_and(|error| error.contains("enter moves to the next")),
        "{:?}",
        robot.form_error()
    );
}

#[test]
fn records_are_exported_into_the_folder_that_was_named_whatever_moves_meanwhile() {
    let mut robot = Robot::at_work(true);
    robot.state.settings.directory = "/home/operator".into();
    robot.types("3");
    robot.site_answers(true);
    robot.types("  e");
    robot.site_answers(true);
    assert_eq!(form(&robot).title, "Export 2 records");
    robot.types("cases");
    let sought = tab(&mut robot);
    assert_eq!(sought.kind, PathKind::Folder, "only folders");
    robot.types("/7");
    robot.presses(Key::Enter);
    let ids = [fixtures::record(1_000, "").id, fixtures::record(999, "").id];
    let mut sent = robot.work();
    sent.sort_by_key(|tag| format!("{tag:?}"));
    assert_eq!(sent, [Tag::Export(ids[1].clone()), Tag::Export(ids[0].clone())]);
    // A second one goes elsewhere before the first is answered; the folder written last is offered.
    robot.types("aae");
    assert_eq!(form(&robot).text(0), "cases/7");
    robot.presses(Key::Control('u'));
    robot.presses(Key::Enter);
    let bases: Vec<(Option<std::path::PathBuf>, bool)> = robot
        .work()
        .into_iter()
        .map(|tag| {
            robot.is_answered(&tag, Ok(Reply::Files(Vec::new())));
            let Some(Effect::WriteFiles { base, directory, .. }) = robot.effects.pop() else { panic!("not written") };
            (base, directory.is_some())
        })
        .collect();
    assert_eq!(
        bases[..2],
        [(Some("/home/operator/cases/7".into()), true), (Some("/home/operator/cases/7".into()), true)]
    );
    assert!(bases[2..].iter().all(|(base, _)| base.is_none()), "{bases:?}");
}
