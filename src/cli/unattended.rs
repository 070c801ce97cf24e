//! `unattended`: the credential with which a site captures while the profile is locked, and its end.

use std::path::{Path, PathBuf};

use clap::Subcommand;

use super::connect::{Context, ProfileNeed};
use super::verbs::{self, CHAIN, Plan};
use super::{adopt, parse};
use crate::crypto::{UnattendedCredential, private_file};
use crate::model::ErrorKind;
use crate::service::command::{EndUnattended, PrepareUnattended};
use crate::service::reply::{UnattendedState, UnattendedView};
use crate::service::{Failure, Site};
use authros_output::Output;
use std::sync::Arc;

/// The name of the credential in systemd's folder.
const NAME: &str = "authros";

/// `unattended …`
#[derive(Debug, Subcommand)]
pub enum UnattendedVerb {
    /// Write the credential: a lent device key, the keys of watched topics and an account that anchors
    Prepare {
        /// The file, 0600 and not encrypted; must not exist
        #[arg(long, value_name = "FILE")]
        out: PathBuf,
        /// Only this watched topic; repeatable [default: all watched topics]
        #[arg(long = "topic", value_name = "TOPIC")]
        topics: Vec<String>,
        /// End of the loan: 30d, 12h, or a time such as 2027-01-31T12:00:00Z
        #[arg(long, value_name = "TIME", default_value = "30d")]
        until: String,
    },
    /// Once its records are anchored, recall the device of the credential: it captures nothing more, and a new epoch begins
    End {
        /// Do not wait for its records to be anchored; those in no block yet stay without an anchor
        #[arg(long)]
        force: bool,
    },
}

/// Makes or ends a credential.
///
/// # Errors
/// Errors of the arguments, the site or the file.
pub async fn run(context: Context, verb: UnattendedVerb, output: &Output) -> Result<u8, Failure> {
    match verb {
        UnattendedVerb::Prepare { out, topics, until } => {
            let wishes = PrepareUnattended { topics: parse::values(&topics)?, until: adopt::end(&until)? };
            prepare(context, wishes, &out, output).await
        }
        UnattendedVerb::End { force } => {
            verbs::run(context, Plan::new(CHAIN, ProfileNeed::Unlocked, EndUnattended { force }), output).await
        }
    }
}

async fn prepare(context: Context, wishes: PrepareUnattended, out: &Path, output: &Output) -> Result<u8, Failure> {
    if out.exists() {
        let advice = "choose another --out, credentials are never overwritten";
        return Err(Failure::new(ErrorKind::Input, format!("{} exists; {advice}", out.display())));
    }
    let connection = context.connect(CHAIN).await?;
    let made = async {
        context.prepare(&connection.client, ProfileNeed::Unlocked, output).await?;
        connection.client.ask(wishes).await
    };
    let made = made.await;
    connection.close().await;
    let made = made?;
    private_file::create_private(out, made.file.expose())?;
    if context.home.passphrase(&context.profile).exists() {
        let beside = context.home.passphrase(&context.profile);
        output.note(&format!(
            "{} is stored beside the keyring, so anyone who reads this home has all keys of '{}'; move it away, or unattended \
             capture protects nothing",
            beside.display(),
            context.profile
        ));
    }
    let document = serde_json::json!({
        "file": out.display().to_string(), "profile": context.profile, "device": made.device, "account": made.account,
        "topics": made.topics, "until": made.until,
    });
    output.result(&document, || {
        format!(
            "{} holds device {}, lent until {}, the keys of {} and the account {}, which anchors; encrypt it with \
             `systemd-creds encrypt --name={NAME}`, remove it, and start `authros serve --unattended`",
            out.display(),
            made.device,
            made.until,
            crate::model::clean(&made.topics.join(", "), 300),
            made.account
        )
    });
    Ok(0)
}

/// Begins to capture with the credential in `file`, or with the one that systemd hands over if that is empty.
///
/// # Errors
/// If there is none, it cannot be read, or it is of another profile, account or chain.
pub async fn begin(context: &Context, site: &Arc<Site>, file: &str) -> Result<UnattendedView, Failure> {
    let path = match (file, std::env::var_os("CREDENTIALS_DIRECTORY")) {
        ("", Some(folder)) => Path::new(&folder).join(NAME),
        ("", None) => {
            let text = "systemd hands over no credential here ($CREDENTIALS_DIRECTORY is not set); give the file: serve \
                        --unattended FILE";
            return Err(Failure::new(ErrorKind::Usage, text));
        }
        (file, _) => PathBuf::from(file),
    };
    site.capture_unattended(&context.profile, UnattendedCredential::read(&path)?).await
}

/// How it stands, in a line.
pub fn line(view: &UnattendedView) -> String {
    let UnattendedView { profile, device, account, topics, .. } = view;
    let until = view.until.map_or_else(|| "it cannot go on".to_owned(), |until| format!("until {until}"));
    let why = view.why.as_deref().map_or_else(String::new, |why| format!(" ({why})"));
    let (topics, device) = (topics.len(), device.to_string().chars().take(8).collect::<String>());
    let account = account.short();
    match view.state {
        UnattendedState::Prepared => format!(
            "unattended capture of '{profile}' is prepared {until}: device {device}, account {account}, topics {topics}"
        ),
        UnattendedState::Capturing => format!(
            "'{profile}' is locked and captured unattended {until}{why}: device {device}, account {account}, topics {topics}"
        ),
        UnattendedState::Ended => format!("unattended capture of '{profile}' has ended{why}"),
        UnattendedState::Attended => format!("'{profile}' was unlocked, and its own keys capture"),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::model::{Address, SignerId, Timestamp};

    #[test]
    fn a_line_says_until_when_and_why() {
        let view = |state, until: Option<u64>, why: Option<&str>| UnattendedView {
            state,
            profile: "alice".parse().expect("a name"),
            device: SignerId([7; 32]),
            account: Address([8; 20]),
            topics: vec!["/odom".to_owned()],
            until: until.map(Timestamp::from_seconds),
            why: why.map(ToOwned::to_owned),
        };
        let text = line(&view(UnattendedState::Capturing, Some(60), Some("the loan of its device ends")));
        assert!(text.contains("until 1970-01-01T00:01:00") && text.contains("(the loan of its device ends)"), "{text}");
        let text = line(&view(UnattendedState::Ended, None, Some("recalled")));
        assert!(text.ends_with("has ended (recalled)"), "{text}");
    }
}
