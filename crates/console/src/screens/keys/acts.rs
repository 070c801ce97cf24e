//! Acts on keys: a new epoch, keys from files and into files.

use crate::app::{
    Confirm, Errand, Field, Form, Line, PathKind, Popup, Purpose, Settings, State, Tag, Wrong, completion,
    twin::kind_word,
};
use crate::popups::{form::export, form::identity, form::identity::SHORTEST_PASSPHRASE};
use crate::service::{Command, KeyKind};

pub fn rotate() -> Confirm {
    let lines = vec![
        "The next record is encrypted under a new key.".to_owned(),
        "Current readers keep access and robots are told. Sends one transaction,".to_owned(),
        "and one more for every eight readers.".to_owned(),
    ];
    let errand = Errand { command: Command::RotateKeys, tag: Tag::Rotate };
    Confirm { title: "Begin a new epoch?".to_owned(), lines, yes: "rotate", typed: None, errand }
}

/// In the order of the choice.
const KINDS: [KeyKind; 3] = [KeyKind::Sm4, KeyKind::Sm2, KeyKind::Eoa];

const KIND_WORDS: &[&str] = &["SM4 (32 hex or 16 raw bytes)", "SM2 (d_C, PEM)", "EOA (V3 keystore or hex)"];

pub fn load_key() -> Form {
    let lines = vec![
        Line::choice("Key", KIND_WORDS),
        Line::text("File", "path to the key file (must be mode 0600)", Field::default()).path(PathKind::File),
        Line::text("Passphrase", "only for a V3 keystore", Field::masked()),
    ];
    Form::new("Load a key file", vec!["Replaces the current key with one of yours.".to_owned()], lines)
}

pub fn read_load(form: &Form, settings: &Settings) -> Result<Confirm, Wrong> {
    let path = completion::of_line(form, 1, settings).ok_or((1, "enter the path of the key file".to_owned()))?;
    let passphrase = (!form.text(2).is_empty()).then(|| identity::secret(form, 2));
    let kind = kind(form);
    let what = match kind {
        KeyKind::Sm4 => "New records are sealed under keys made from it, in a new epoch; old ones keep theirs.",
        KeyKind::Sm2 => "New records are signed with it; if you are registered, the chain gets it first.",
        KeyKind::Eoa => "Your address on the chain changes: grants and records of the old one stay with it.",
    };
    let file = format!("File  {}", path.display());
    let lines =
        vec![file, what.to_owned(), "The current key is replaced; export it first if you still need it.".to_owned()];
    let errand = Errand { command: Command::LoadKey { kind, path, passphrase }, tag: Tag::LoadKey(kind) };
    Ok(Confirm { title: format!("Replace the {} key?", kind_word(kind)), lines, yes: "replace", typed: None, errand })
}

pub fn export_key(folder: Line) -> Form {
    let lines = vec![
        Line::choice("Key", KIND_WORDS),
        Line::text("Passphrase", "EOA: protects the V3 keystore", Field::masked()),
        Line::text("Repeat", "", Field::masked()),
        folder,
    ];
    let notes = vec!["Writes a secret key to a file. Anyone who has it can act or read as you.".to_owned()];
    Form::new("Export a key", notes, lines)
}

pub fn read_export(form: &Form) -> Result<Errand, Wrong> {
    let kind = kind(form);
    if kind == KeyKind::Eoa && form.text(1).chars().count() < SHORTEST_PASSPHRASE {
        return Err((1, format!("an EOA is exported as a keystore; use at least {SHORTEST_PASSPHRASE} characters")));
    }
    if form.text(1) != form.text(2) {
        return Err((2, "the passphrases do not match; type it again".to_owned()));
    }
    let passphrase = (kind == KeyKind::Eoa).then(|| identity::secret(form, 1));
    Ok(Errand { command: Command::ExportKey { kind, passphrase }, tag: Tag::ExportKey(kind) })
}

fn kind(form: &Form) -> KeyKind {
    KINDS.get(form.chosen(0)).copied().unwrap_or(KeyKind::Sm4)
}

pub fn begin_key(state: &mut State) {
    let form = export_key(export::folder_line(state));
    state.popups.push(Popup::Form(Purpose::ExportKey, form));
}
