//! `devices`: what its arguments mean, and its table.

use std::path::Path;

use clap::Subcommand;

use super::parse;
use super::show::Question;
use crate::crypto::keyfile::{load_sm2, sm2_public_from_pem};
use crate::crypto::{ProviderName, SmKeyPair, provider, signer_id};
use crate::model::bytes::unhex;
use crate::model::{ErrorKind, PublicKey, SignerId};
use crate::service::Failure;
use crate::service::command::{AddDeviceAddress, AddDeviceTopics, LendDevice, ListDevices, RecallDevice};
use crate::service::reply::DeviceRow;
use authros_output::table;

/// The longest file that is looked at for a public key, bytes.
const LONGEST: u64 = 16 * 1024;

/// `devices …`
#[derive(Debug, Subcommand)]
pub enum DevicesVerb {
    /// Let a device sign for this profile (a loan)
    Lend {
        /// Id of the device (64 hex), or the file of its SM2 key (public PEM, or private 0600)
        #[arg(value_name = "ID_OR_KEYFILE")]
        device: String,
        /// End of the loan: 30d, 12h, or a time such as 2027-01-31T12:00:00Z
        #[arg(long, value_name = "TIME")]
        until: Option<String>,
    },
    /// Recall a device: it can no longer sign or read, its sessions end, and a new epoch begins
    Recall {
        /// Id of the device or its first characters, its fingerprint, or the name it was enrolled under
        #[arg(value_name = "ID")]
        device: String,
    },
    /// The topics an enrolled robot may record
    #[command(subcommand)]
    Topics(TopicsVerb),
    /// Where an enrolled robot finds its gateway
    #[command(subcommand)]
    Addresses(AddressesVerb),
    /// List devices on loan and recalled ones
    List,
}

/// `devices topics …`
#[derive(Debug, Subcommand)]
pub enum TopicsVerb {
    /// Give a robot the keys of more topics; it picks them up automatically
    Add {
        /// Name of the robot, or the device's id, its first characters, or its fingerprint
        #[arg(value_name = "DEVICE")]
        device: String,
        /// The topics
        #[arg(value_name = "TOPIC", required = true)]
        topics: Vec<String>,
    },
}

/// `devices addresses …`
#[derive(Debug, Subcommand)]
pub enum AddressesVerb {
    /// Give a robot a further address of its gateway; it learns it with its next contact
    Add {
        /// Name of the robot, or the device's id, its first characters, or its fingerprint
        #[arg(value_name = "DEVICE")]
        device: String,
        /// The address
        #[arg(value_name = "HOST:PORT")]
        address: String,
    },
}

/// The command for a verb.
///
/// # Errors
/// What is wrong with the arguments.
pub fn question(verb: &DevicesVerb) -> Result<Question, Failure> {
    Ok(match verb {
        DevicesVerb::Lend { device, until } => {
            LendDevice { device: device_of(device)?, until: until.as_deref().map(parse::end).transpose()? }.into()
        }
        DevicesVerb::Recall { device } => RecallDevice { device: device.clone() }.into(),
        DevicesVerb::Topics(TopicsVerb::Add { device, topics }) => {
            AddDeviceTopics { device: device.clone(), topics: parse::values(topics)? }.into()
        }
        DevicesVerb::Addresses(AddressesVerb::Add { device, address }) => {
            AddDeviceAddress { device: device.clone(), address: address.clone() }.into()
        }
        DevicesVerb::List => ListDevices.into(),
    })
}

fn device_of(text: &str) -> Result<SignerId, Failure> {
    let path = Path::new(text);
    if path.is_file() {
        return Ok(signer_id(&public_key(path)?));
    }
    unhex(text).and_then(|bytes| SignerId::from_slice(&bytes)).ok_or_else(|| {
        let advice = "a fingerprint alone is not enough to lend to; give the key file";
        Failure::new(
            ErrorKind::Input,
            format!("give a device as 64 hex characters or as the file of its SM2 key; {advice}"),
        )
    })
}

fn public_key(path: &Path) -> Result<PublicKey, Failure> {
    let broken = |error: std::io::Error| Failure::new(ErrorKind::Input, format!("{}: {error}", path.display()));
    if std::fs::metadata(path).map_err(broken)?.len() > LONGEST {
        return Err(Failure::new(ErrorKind::Input, format!("{} is too long to be a key", path.display())));
    }
    let bytes = std::fs::read(path).map_err(broken)?;
    if String::from_utf8_lossy(&bytes).contains("BEGIN PUBLIC KEY") {
        return Ok(sm2_public_from_pem(&String::from_utf8_lossy(&bytes))?);
    }
    let secret = load_sm2(path)?;
    Ok(SmKeyPair::from_secret(provider(ProviderName::default()), secret)?.public)
}

/// The devices, for people.
pub fn devices(rows: &[DeviceRow]) -> String {
    let or_dash = |text: Option<String>| text.unwrap_or_else(|| "-".to_owned());
    let row = |row: &DeviceRow| {
        vec![
            row.device.to_string(),
            row.fingerprint.clone(),
            row.state.clone(),
            row.from.to_string(),
            or_dash(row.until.map(|until| until.to_string())),
            or_dash(row.recalled.map(|block| block.to_string())),
        ]
    };
    let rows: Vec<Vec<String>> = rows.iter().map(row).collect();
    table(&["device", "fingerprint", "state", "from block", "until", "recalled at"], &rows)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_device_is_named_by_its_id_or_its_key() {
        let home = tempfile::tempdir().expect("folder");
        let pair = SmKeyPair::generate(provider(ProviderName::default())).expect("pair");
        let id = signer_id(&pair.public);
        let public = home.path().join("device.pem");
        std::fs::write(&public, crate::crypto::keyfile::sm2_public_pem(&pair.public).expect("pem")).expect("written");
        let private = home.path().join("device.key");
        let pem = crate::crypto::keyfile::sm2_pem(&pair.secret).expect("pem");
        crate::crypto::private_file::create_private(&private, pem.as_bytes()).expect("written");
        for name in [id.to_string(), format!("0x{id}"), public.display().to_string(), private.display().to_string()] {
            assert_eq!(device_of(&name).ok(), Some(id), "{name}");
        }
        assert!(device_of(&id.to_string()[..32]).is_err() && device_of("nowhere.pem").is_err());
        std::fs::write(&public, "no key").expect("written");
        assert!(device_of(&public.display().to_string()).is_err());
    }
}
