//! Forms that ask for a passphrase.

use crate::app::{Errand, Field, Form, Line, Tag, Wrong};
use crate::service::{Command, SecretText};

/// Characters.
pub const SHORTEST_PASSPHRASE: usize = 8;

pub fn create_identity(profile: &str, notes: Vec<String>) -> Form {
    let lines = vec![
        Line::text("Passphrase", "at least 8 characters", Field::masked()),
        Line::text("Repeat", "", Field::masked()),
    ];
    Form::new(format!("New identity for profile {profile}"), notes, lines)
}

pub fn read_create(form: &Form) -> Result<Errand, Wrong> {
    if form.text(0).chars().count() < SHORTEST_PASSPHRASE {
        return Err((0, format!("use at least {SHORTEST_PASSPHRASE} characters")));
    }
    if form.text(0) != form.text(1) {
        return Err((1, "the passphrases do not match; type it again".to_owned()));
    }
    Ok(Errand { command: Command::CreateIdentity { passphrase: secret(form, 0) }, tag: Tag::CreateIdentity })
}

pub fn unlock(profile: &str, notes: Vec<String>) -> Form {
    let lines = vec![Line::text("Passphrase", "", Field::masked())];
    Form::new(format!("Unlock the keyring of profile {profile}"), notes, lines)
}

pub fn read_unlock(form: &Form) -> Result<Errand, Wrong> {
    if form.text(0).is_empty() {
        return Err((0, "type the passphrase, or leave with esc".to_owned()));
    }
    Ok(Errand { command: Command::Unlock { passphrase: secret(form, 0) }, tag: Tag::Unlock })
}

pub fn secret(form: &Form, line: usize) -> SecretText {
    SecretText::new(form.text(line).to_owned())
}
