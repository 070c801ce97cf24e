//! `authros identity`.

#![deny(clippy::wildcard_enum_match_arm)]

use clap::Subcommand;

use super::connect::{Context, ProfileNeed};
use super::plan::{CHAIN, NEITHER, Plan};
use super::show::{Question, or_dash, yes};
use super::{parse, passphrase};
use crate::crypto::{Fingerprint, read_public};
use crate::model::{Address, ProfileName};
use crate::service::{Client, Failure, command, reply};
use authros_output::{Output, pairs, table};

/// `identity …`
#[derive(Debug, Subcommand)]
pub enum IdentityVerb {
    /// Create an identity: EOA, SM2 and SM4 keys
    Create,
    /// Register the identity on the chain
    Register,
    /// Show the public identity
    Show,
    /// List this home's identities: profile, account, fingerprint of the signing key; works offline
    List,
    /// Check a fingerprint against this profile's key, or an account's
    Compare {
        /// Fingerprint: eight groups of four hex digits, quoted or without spaces
        fingerprint: String,
        /// Account, or its name [default: this profile]
        #[arg(long, value_name = "ACCOUNT")]
        account: Option<String>,
    },
    /// Set the recovery account, which can stop a wrongly proposed succession of this account
    Recovery {
        /// Account, its name, or `none`; takes effect after the contract's delay
        #[arg(value_name = "ACCOUNT")]
        account: String,
    },
}

pub fn plan(verb: IdentityVerb) -> Result<Plan, Failure> {
    Ok(match verb {
        // `run` handles creation and lists.
        IdentityVerb::Create | IdentityVerb::Show | IdentityVerb::List => Plan::public(command::ShowIdentity),
        IdentityVerb::Compare { fingerprint, account } => {
            let needs = if account.is_some() { CHAIN } else { NEITHER };
            let account = parse::optional(account.as_deref())?;
            Plan::new(needs, ProfileNeed::None, command::CompareFingerprint { fingerprint, account })
        }
        IdentityVerb::Recovery { account } => {
            let recovery = if account == "none" { None } else { Some(parse::value(&account)?) };
            Plan::unlocked(command::NameRecovery { recovery })
        }
        IdentityVerb::Register => Plan::new(CHAIN, ProfileNeed::Made, command::Register),
    })
}

/// The passphrase is written once the site is there: without its keyring it opens nothing.
pub async fn create(context: Context, output: &Output) -> Result<u8, Failure> {
    let create = async |client: &Client| {
        let (passphrase, is_new) = passphrase::given_or_new(&context, output)?;
        Ok((Question::from(command::CreateIdentity { passphrase }).ask(client).await, is_new))
    };
    let (told, is_new) = context.with(NEITHER, ProfileNeed::None, output, create).await?;
    let printed = told.print(None, output);
    printed.inspect_err(|_| passphrase::forget_unused(is_new, &context))
}

pub fn list(context: &Context, output: &Output) -> Result<u8, Failure> {
    let mut rows = Vec::new();
    for profile in context.home.profiles() {
        let public = read_public(&context.home.keyring(&profile))?;
        rows.push((profile == context.profile, profile, public.address, Fingerprint::of(&public.signing).to_string()));
    }
    let json: Vec<serde_json::Value> = rows
        .iter()
        .map(|(used, profile, address, fingerprint)| {
            serde_json::json!({ "profile": profile, "used": used, "address": address, "fingerprint": fingerprint })
        })
        .collect();
    output.result(&serde_json::json!({ "identities": json }), || {
        if rows.is_empty() {
            return "no identity yet; create one with `authros identity create`".to_owned();
        }
        let line = |(used, profile, address, fingerprint): &(bool, ProfileName, Address, String)| {
            let mark = if *used { "*" } else { " " };
            [format!("{mark} {profile}"), address.to_string(), fingerprint.clone()]
        };
        table(&["  profile", "address", "fingerprint"], rows.iter().map(line))
    });
    Ok(0)
}

pub fn one(view: &reply::IdentityView) -> String {
    pairs(&[
        ("profile", view.profile.to_string()),
        ("registered", yes(view.registered)),
        ("address", or_dash(view.address)),
        ("epoch", or_dash(view.epoch)),
        ("fingerprint", or_dash(view.fingerprint.as_ref())),
        ("signing key", or_dash(view.signing_key)),
        ("envelope key", or_dash(view.envelope_key)),
    ])
}
