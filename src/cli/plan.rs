//! A verb with one request, whose answer is printed.

use std::path::PathBuf;

use super::connect::{Context, ProfileNeed};
use super::{passphrase, printed, show::Question};
use crate::service::{Command, Failure, Needs, command};
use authros_output::Output;

pub const CHAIN: Needs = Needs { ros: false, chain: true };
pub const ROS: Needs = Needs { ros: true, chain: false };
pub const NEITHER: Needs = Needs { ros: false, chain: false };

pub struct Plan {
    pub needs: Needs,
    pub profile: ProfileNeed,
    /// Asked first; its answer goes to stderr.
    pub first: Option<command::ForeseeKeyChange>,
    pub question: Question,
    pub out: Option<PathBuf>,
}

impl Plan {
    pub fn new(needs: Needs, profile: ProfileNeed, question: impl Into<Question>) -> Self {
        Self { needs, profile, first: None, question: question.into(), out: None }
    }

    /// With the chain and an open keyring.
    pub fn unlocked(question: impl Into<Question>) -> Self {
        Self::new(CHAIN, ProfileNeed::Unlocked, question)
    }

    /// With the chain, without a keyring.
    pub fn public(question: impl Into<Question>) -> Self {
        Self::new(CHAIN, ProfileNeed::None, question)
    }

    /// With the store alone.
    pub fn kept(question: impl Into<Question>) -> Self {
        Self::new(NEITHER, ProfileNeed::None, question)
    }
}

const NOT_FETCHED: &str = "start `authros serve` to fetch what is new: this home has its records from a gateway, which is \
                           only asked while a site of it runs; this is what was fetched before";

/// Whether a site that joins a gateway answers it with what it fetched there.
fn is_of_gateway(command: &Command) -> bool {
    matches!(command, Command::OfRobot(_) | Command::ListUploads { .. } | Command::ListAllUploads { .. })
}

/// Whether more of what it shows is checked while a keyring is open.
fn is_fuller_open(command: &Command) -> bool {
    let of_records =
        matches!(command, Command::ListUploads(_) | Command::ListAllUploads(_) | Command::ShowUpload { .. });
    of_records
        || matches!(command, Command::TopicCoverage { .. } | Command::ListQuarantine { .. } | Command::OfIncident(_))
}

pub async fn run(context: Context, plan: Plan, output: &Output) -> Result<u8, Failure> {
    let connection = context.connect(plan.needs).await?;
    connection.tell_read_only(output);
    let is_own = connection.site.is_some();
    if is_own && context.config.site.is_some() && !plan.needs.chain && is_of_gateway(&plan.question.command) {
        output.note(NOT_FETCHED);
    }
    let forgets = matches!(plan.question.command, Command::ChangePassphrase { .. });
    let told = async {
        let opens = || passphrase::is_passed(&context.global) && is_fuller_open(&plan.question.command);
        let need = match plan.profile {
            ProfileNeed::OpenAtSite if is_own => ProfileNeed::None,
            ProfileNeed::None if opens() => ProfileNeed::Unlocked,
            need => need,
        };
        context.prepare(&connection.client, need, output).await?;
        if let Some(first) = plan.first {
            connection.client.ask(first).await?.lines.iter().for_each(|line| output.note(line));
        }
        let long = matches!(plan.question.command, Command::AuditRecords { .. });
        let answer = plan.question.ask(&connection.client);
        Ok(if long { printed::told(&connection.client, answer, output).await } else { answer.await })
    };
    let told: Result<_, Failure> = told.await;
    connection.close().await;
    let told = told?;
    if forgets && told.reply.is_ok() {
        passphrase::forget(&context.home, &context.profile, output)?;
    }
    told.print(plan.out.as_deref(), output)
}
