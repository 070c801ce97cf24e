//! Keys: loading from a file needs a confirmation, exporting writes a file.

use super::{Robot, fixtures};
use crate::app::{Effect, Key, Popup, Tag};
use crate::model::ErrorKind;
use crate::service::{Command, KeyKind, Reply, SecretBytes};

fn at_keys() -> Robot {
    let mut robot = Robot::at_work(true);
    robot.state.settings.directory = "/home/operator".into();
    robot.types("6");
    robot.site_answers(true);
    robot
}

#[test]
fn a_key_file_is_loaded_after_a_yes_with_an_absolute_path() {
    let mut robot = at_keys();
    robot.types("L ");
    robot.presses(Key::Tab);
    robot.types("keys/sm2.pem");
    robot.presses(Key::Enter);
    robot.presses(Key::Enter);
    assert!(matches!(robot.state.popups.last(), Some(Popup::Confirm(confirm)) if confirm.title.contains("SM2")));
    robot.types("y");
    let (command, _) = robot.sent.last().expect("sent");
    assert!(
        matches!(command, Command::LoadKey { kind: KeyKind::Sm2, path, passphrase: None } if path.as_os_str() == "/home/operator/keys/sm2.pem")
    );
    robot.is_answered(&Tag::LoadKey(KeyKind::Sm2), Err(fixtures::failure(ErrorKind::Input, "it holds 15 bytes")));
    assert!(robot.form_error().is_some_and(|error| error.contains("15 bytes")));
}

#[test]
fn an_empty_path_is_refused_in_the_form() {
    let mut robot = at_keys();
    robot.types("L");
    for _ in 0..3 {
        robot.presses(Key::Enter);
    }
    assert!(robot.form_error().is_some_and(|error| error.contains("path")));
}

#[test]
fn an_eoa_leaves_only_under_a_passphrase_and_a_key_becomes_a_file() {
    let mut robot = at_keys();
    robot.types("e  ");
    for _ in 0..4 {
        robot.presses(Key::Enter);
    }
    assert!(robot.form_error().is_some_and(|error| error.contains("keystore")));
    robot.presses(Key::Escape);
    robot.types("e");
    for _ in 0..4 {
        robot.presses(Key::Enter);
    }
    let key = Reply::Key(SecretBytes::new(vec![7; 16]));
    robot.is_answered(&Tag::ExportKey(KeyKind::Sm4), Ok(key));
    let Some(Effect::WriteFiles { files, .. }) = robot.effects.last() else { panic!("nothing written") };
    assert_eq!(files[0].name, "default-sm4.key");
    assert!(!format!("{:?}", robot.effects).contains("7, 7"));
}

#[test]
fn a_rotation_is_asked_about() {
    let mut robot = at_keys();
    robot.types("r");
    robot.presses(Key::Enter);
    assert!(robot.work().is_empty());
    robot.types("ry");
    assert_eq!(robot.work(), [Tag::Rotate]);
}
