//! `authros tour`: the console in a home of its own, with simulated robots, a reader to share with, and a strip that
//! leads through the paper's mission. The home is removed with the console.

use tokio::runtime::Runtime;

use super::args::{ConsoleArguments, TourArguments};
use super::connect::Context;
use super::demo;
use crate::app::tour::Cast;
use crate::crypto::Passphrase;
use crate::model::{ContactName, ErrorKind, ProfileName};
use crate::service::command::{AddContact, CreateIdentity, Register, SecretText};
use crate::service::{Client, Failure};

/// The robots' owner in the paper.
const OWNER: &str = "cura-a";
/// The reader.
const READER: &str = "cura-b";

/// Runs the console with the tour.
///
/// # Errors
/// Without a terminal or robots, or if no temporary home can be created.
pub fn run(runtime: &Runtime, mut context: Context, arguments: TourArguments) -> Result<u8, Failure> {
    if context.global.home.is_some() {
        let text = "the tour uses its own home, which is removed afterwards; omit --home and AUTHROS_HOME";
        return Err(Failure::new(ErrorKind::Usage, text));
    }
    if context.config.robots == 0 {
        return Err(Failure::new(
            ErrorKind::Usage,
            "the tour needs robots; use --robots 1 to 32 and no real ROS master",
        ));
    }
    let temporary = demo::temporary_home(&mut context, "authros-tour-")?;
    context.profile = super::parse::value(OWNER)?;
    let cast = Cast { owner: context.profile.clone(), reader: super::parse::value(READER)? };
    let TourArguments { theme, ascii } = arguments;
    let console = ConsoleArguments { theme, ascii, ..ConsoleArguments::default() };
    let ended = super::console::run(runtime, context, console, Some(cast));
    drop(temporary);
    ended
}

/// Creates the reader, registers it on the chain and adds it to the address book.
///
/// # Errors
/// Errors of the site.
pub async fn prepare(client: &Client, reader: ProfileName) -> Result<(), Failure> {
    let name: ContactName = super::parse::value(reader.as_str())?;
    let of_reader = client.for_profile(reader);
    let passphrase = SecretText::new(Passphrase::random()?.expose().to_owned());
    let made = of_reader.ask(CreateIdentity { passphrase }).await?;
    of_reader.ask(Register).await?;
    if let Some(address) = made.address {
        client.ask(AddContact { name, address, fingerprint: None }).await?;
    }
    Ok(())
}
