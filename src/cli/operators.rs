//! `operators`: people who work at a profile with keys of their own, and `--operator`: a command as one of them.

use std::path::{Path, PathBuf};

use clap::Subcommand;

use super::args::Global;
use super::connect::{Context, ProfileNeed};
use super::verbs::{self, NEITHER, Plan};
use super::{parse, passphrase};
use crate::crypto::{Fingerprint, OperatorKey, ProviderName, provider};
use crate::model::{ErrorKind, OperatorName, PublicKey};
use crate::service::command::{ActAsOperator, AddOperator, ChallengeOperator, ListOperators, RemoveOperator, Unlock};
use crate::service::reply::OperatorView;
use crate::service::socket::Greeting;
use crate::service::{Client, Failure};
use authros_output::{Output, table};

/// `operators …`
#[derive(Debug, Subcommand)]
pub enum OperatorsVerb {
    /// Let a person work at this profile with a key of their own: makes the key's file, or certifies a key of theirs
    Add {
        /// Their name here: 1 to 32 of a-z, 0-9, - and _
        name: String,
        /// look (read without decrypting), capture (watches, captures, rules, pins), grant (grants, revocations)
        #[arg(long, value_name = "RIGHTS")]
        rights: String,
        /// End of their time: 30d, 12h, or a time such as 2027-01-31T12:00:00Z [default: until they are removed]
        #[arg(long, value_name = "TIME")]
        until: Option<String>,
        /// File for the new key, 0600, sealed under a passphrase of its own; must not exist [default: NAME.operator]
        #[arg(long, value_name = "FILE", conflicts_with = "key")]
        out: Option<PathBuf>,
        /// Instead: the public key that `operators key` showed them, 128 hex characters
        #[arg(long, value_name = "KEY")]
        key: Option<String>,
        /// File with the passphrase for the new key (first line) [default: typed twice]
        #[arg(long, value_name = "FILE", conflicts_with = "key")]
        operator_passphrase_file: Option<PathBuf>,
    },
    /// Make a key for yourself and show its public part, for the owner of a profile to add
    Key {
        /// Your name there
        name: String,
        /// File for the new key; must not exist [default: NAME.operator]
        #[arg(long, value_name = "FILE")]
        out: Option<PathBuf>,
        /// File with the passphrase for the new key (first line) [default: typed twice]
        #[arg(long, value_name = "FILE")]
        operator_passphrase_file: Option<PathBuf>,
    },
    /// The operators of this profile
    List,
    /// End an operator, at once
    Remove {
        /// Their name
        name: String,
    },
}

/// `operators …`
///
/// # Errors
/// Errors of the arguments, the file or the site.
pub async fn run(context: Context, verb: OperatorsVerb, output: &Output) -> Result<u8, Failure> {
    match verb {
        OperatorsVerb::List => verbs::run(context, Plan::new(NEITHER, ProfileNeed::None, ListOperators), output).await,
        OperatorsVerb::Remove { name } => {
            let ask = RemoveOperator { name: parse::value(&name)? };
            verbs::run(context, Plan::new(NEITHER, ProfileNeed::None, ask), output).await
        }
        OperatorsVerb::Key { name, out, operator_passphrase_file } => {
            let made = Made::new(context.config.provider, &name, out, operator_passphrase_file.as_deref())?;
            made.show(output);
            Ok(0)
        }
        OperatorsVerb::Add { name, rights, until, out, key, operator_passphrase_file } => {
            let rights = parse::value(&rights)?;
            let until = until.as_deref().map(parse::end).transpose()?;
            let ask = |name: OperatorName, key: PublicKey| AddOperator { name, key, rights, until };
            if let Some(key) = key {
                let ask = ask(parse::value(&name)?, parse::value(&key)?);
                return verbs::run(context, Plan::new(NEITHER, ProfileNeed::Unlocked, ask), output).await;
            }
            let made = Made::new(context.config.provider, &name, out, operator_passphrase_file.as_deref())?;
            let ask = ask(made.name.clone(), made.public);
            let told = verbs::run(context, Plan::new(NEITHER, ProfileNeed::Unlocked, ask), output).await;
            match &told {
                Ok(_) => output.note(&format!(
                    "the key of '{}' is {} (0600); it works with --operator FILE and its passphrase, and only at a \
                     running site of this home",
                    made.name,
                    made.file.display()
                )),
                // A key that nobody certified is of no use.
                Err(_) => drop(std::fs::remove_file(&made.file)),
            }
            told
        }
    }
}

/// A key that was made, in its file.
struct Made {
    name: OperatorName,
    public: PublicKey,
    file: PathBuf,
}

impl Made {
    fn new(
        algorithms: ProviderName,
        name: &str,
        out: Option<PathBuf>,
        passphrase_file: Option<&Path>,
    ) -> Result<Self, Failure> {
        let name: OperatorName = parse::value(name)?;
        let file = out.unwrap_or_else(|| PathBuf::from(format!("{name}.operator")));
        if file.exists() {
            let advice = "choose another --out, keys are never overwritten";
            return Err(Failure::new(ErrorKind::Input, format!("{} exists; {advice}", file.display())));
        }
        let passphrase = passphrase::of_new(passphrase_file, "--operator-passphrase-file")?;
        let provider = provider(algorithms);
        let key = OperatorKey::generate(provider, name)?;
        key.create(provider, &file, &passphrase)?;
        Ok(Self { name: key.name.clone(), public: key.pair.public, file })
    }

    fn show(&self, output: &Output) {
        let document = serde_json::json!({
            "name": self.name, "key": self.public, "file": self.file.display().to_string(),
        });
        output.result(&document, || {
            format!(
                "{} holds the key of '{}'; have the owner of the profile run `authros operators add {} --rights look \
                 --key {}`",
                self.file.display(),
                self.name,
                self.name,
                self.public
            )
        });
    }
}

/// The key of `--operator`, opened; `None` without it.
///
/// # Errors
/// If the file or its passphrase is wrong.
pub fn key(global: &Global, algorithms: ProviderName) -> Result<Option<OperatorKey>, Failure> {
    let Some(file) = &global.operator else { return Ok(None) };
    let passphrase = passphrase::of_operator(global, file)?;
    Ok(Some(OperatorKey::open(provider(algorithms), file, &passphrase)?))
}

/// An operator's key opens no home.
///
/// # Errors
/// If this is an operator's command.
pub fn needs_site(context: &Context) -> Result<(), Failure> {
    match &context.operator {
        None => Ok(()),
        Some(operator) => Err(Failure::new(
            ErrorKind::Unreachable,
            format!(
                "no site of {} is running, and the key of operator '{}' opens none; its owner starts it with `authros \
                 serve`",
                context.home.root().display(),
                operator.name
            ),
        )),
    }
}

/// Shows a running site who asks: an operator by its key, or, where the site requires that, the owner by the passphrase.
///
/// # Errors
/// The site's refusal.
pub async fn introduce(context: &Context, client: &Client, greeting: &Greeting) -> Result<(), Failure> {
    if let Some(operator) = &context.operator {
        let asked = client.ask(ChallengeOperator).await?;
        let what = (&asked.challenge.0, &asked.account, context.profile.as_str());
        let proof = operator.prove(provider(context.config.provider), what)?;
        client.ask(ActAsOperator { name: operator.name.clone(), proof }).await?;
    } else if greeting.operators_required
        && let Some(passphrase) = passphrase::given(&context.global, &context.home, &context.profile)?
    {
        client.ask(Unlock { passphrase }).await?;
    }
    Ok(())
}

/// All operators of a profile.
pub fn all(operators: &[OperatorView]) -> String {
    if operators.is_empty() {
        return "no operators; add one with `authros operators add NAME --rights look,capture`".to_owned();
    }
    let row = |one: &OperatorView| {
        vec![
            one.name.to_string(),
            one.rights.to_string(),
            one.state.word().to_owned(),
            one.from.to_string(),
            one.until.map_or_else(|| "removed".to_owned(), |until| until.to_string()),
            Fingerprint::of_signer(&one.key).to_string(),
        ]
    };
    let rows: Vec<Vec<String>> = operators.iter().map(row).collect();
    table(&["operator", "rights", "", "from", "until", "fingerprint of the key"], &rows)
}
