//! Passphrases that a person types. Where standard input is no terminal, nobody is asked.

use super::{Failure, SecretText, input, usage};
use crate::crypto::{CryptoError, Passphrase, SHORTEST_PASSPHRASE};
use crate::service::reply::refused;
use crate::term::secret::Hidden;

const ATTEMPTS: usize = 3;

/// The terminal without its echo; `None` if there is none.
pub fn begin() -> Result<Option<Hidden>, Failure> {
    Hidden::begin().map_err(|error| unread(&error))
}

fn unread(error: &std::io::Error) -> Failure {
    input(format!("the terminal gives no passphrase: {error}; pass {}", super::SOURCES))
}

fn answer(hidden: &mut Hidden, question: &str) -> Result<SecretText, Failure> {
    let typed = hidden.ask(question).map_err(|error| unread(&error))?;
    let typed = typed.ok_or_else(|| refused("no passphrase was given; nothing was done"))?;
    Ok(SecretText::new(typed.to_string()))
}

/// What `open` makes of the passphrase that is right, and that passphrase; asks three times at most.
pub fn that_opens<T>(
    hidden: &mut Hidden,
    question: &str,
    mut open: impl FnMut(&Passphrase) -> Result<T, CryptoError>,
) -> Result<(SecretText, T), Failure> {
    for attempt in 0..ATTEMPTS {
        let again = if attempt == 0 { "" } else { "Wrong passphrase, try again.\n" };
        let typed = answer(hidden, &format!("{again}{question}"))?;
        // None is that short.
        let Ok(passphrase) = Passphrase::new(typed.expose().to_owned()) else { continue };
        match open(&passphrase) {
            Ok(opened) => return Ok((typed, opened)),
            Err(CryptoError::WrongPassphrase(_)) => {}
            Err(error) => return Err(error.into()),
        }
    }
    Err(refused("wrong passphrase, three times; nothing was done (docs/operator.md says what to do if it is lost)"))
}

/// A new one, typed twice; `None` if there is no terminal.
pub fn new_one(question: &str) -> Result<Option<SecretText>, Failure> {
    let Some(mut hidden) = begin()? else { return Ok(None) };
    let mut wrong = String::new();
    for _ in 0..ATTEMPTS {
        let typed = answer(&mut hidden, &format!("{wrong}{question}"))?;
        if typed.expose().chars().count() < SHORTEST_PASSPHRASE {
            wrong = format!("Use at least {SHORTEST_PASSPHRASE} characters. ");
        } else if answer(&mut hidden, "Repeat it")?.expose() == typed.expose() {
            return Ok(Some(typed));
        } else {
            "The two do not match. ".clone_into(&mut wrong);
        }
    }
    Err(usage("no new passphrase after three attempts; nothing was changed"))
}

/// One that is checked later; `None` if there is no terminal.
pub fn once(question: &str) -> Result<Option<SecretText>, Failure> {
    let Some(mut hidden) = begin()? else { return Ok(None) };
    answer(&mut hidden, question).map(Some)
}
