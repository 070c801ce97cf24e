//! `authros status`: health of parts and states of records. Exit code 6: records are gone or altered; 4: a part is not
//! healthy.

#![deny(clippy::wildcard_enum_match_arm)]

use std::time::Duration;

use authros_output::{Output, table};
use clap::Subcommand;

use super::connect::Context;
use super::plan::{NEITHER, Plan};
use crate::model::{ErrorKind, Timestamp, counted};
use crate::service::command::{ListAlerts, SiteStatus, TestAlert};
use crate::service::{Failure, doctor, reply, reply::input};

pub async fn run(context: Context, output: &Output) -> Result<u8, Failure> {
    known(&context)?;
    let connection = context.connect(NEITHER).await?;
    let asked = connection.client.ask(SiteStatus).await;
    // A home that cannot be written has its chain opened in a copy.
    let peers = match connection.site.as_ref().map(|site| site.place()) {
        Some(home) => doctor::peers(&home, &context.config).await,
        None => Vec::new(),
    };
    connection.close().await;
    let mut view = asked?;
    for peer in peers {
        match view.health.iter_mut().find(|part| part.part == peer.part) {
            Some(part) => *part = peer,
            None => view.health.push(peer),
        }
    }
    output.result(&view, || text(&view));
    Ok(code(&view))
}

const LOOK: Duration = Duration::from_secs(2);

pub async fn watch(context: Context, output: &Output) -> Result<u8, Failure> {
    known(&context)?;
    let connection = context.connect(NEITHER).await?;
    if connection.site.is_some() {
        connection.close().await;
        let root = context.home.root().display();
        return Err(input(format!("no site of {root} is running; start one with `authros serve` or the console")));
    }
    let end = super::serve::asked_to_end();
    tokio::pin!(end);
    let mut shown = None;
    loop {
        let view = tokio::select! {
            view = connection.client.ask(SiteStatus) => view?,
            _ = &mut end => return Ok(0),
        };
        if shown.as_ref() != Some(&view) {
            output.result(&view, || format!("{}\n{}\n", Timestamp::now(), text(&view)));
            shown = Some(view);
        }
        tokio::select! {
            () = tokio::time::sleep(LOOK) => {}
            _ = &mut end => return Ok(0),
        }
    }
}

/// A named profile, or the default one beside others, must exist.
fn known(context: &Context) -> Result<(), Failure> {
    if context.operator.is_some() || context.home.keyring(&context.profile).exists() {
        return Ok(());
    }
    let others: Vec<String> = context.home.profiles().iter().map(ToString::to_string).collect();
    if context.global.profile.is_none() && others.is_empty() {
        return Ok(());
    }
    let there =
        if others.is_empty() { "it has no profiles yet".to_owned() } else { format!("it has {}", others.join(", ")) };
    let root = context.home.root().display();
    Err(input(format!("the home {root} has no profile '{}'; {there}: choose one with --profile", context.profile)))
}

fn code(view: &reply::SiteView) -> u8 {
    view.worst().map_or(0, ErrorKind::exit_code)
}

fn row(part: &reply::PartHealth) -> String {
    let word = match part.level {
        reply::HealthLevel::Ok => "ok",
        reply::HealthLevel::Waiting => "waiting",
        reply::HealthLevel::Failed => "failed",
        reply::HealthLevel::Absent => "absent",
    };
    format!("{:<9} {word:<8} {}", part.part, part.text)
}

fn text(view: &reply::SiteView) -> String {
    let mut lines: Vec<String> = view.health.iter().map(row).collect();
    lines.extend(life(&view.life));
    let stands = |alert: &reply::AlertView| {
        format!(
            "alert since {}, {}: {}: {}",
            alert.begun.in_milliseconds(),
            alert.severity.word(),
            alert.key,
            alert.text
        )
    };
    lines.extend(view.alerts.iter().map(stands));
    lines.extend(view.alerts_over.iter().map(over));
    lines.join("\n")
}

fn life(life: &reply::LifeLine) -> Vec<String> {
    let reply::LifeLine { captured, verified, pending, right_ended, quarantined, dropped, tampered, .. } = *life;
    let sum = format!(
        "captured {captured} = verified {verified} + pending {pending} + unauthorised {right_ended} + quarantined \
         {quarantined} + dropped {dropped} + tampered {tampered}"
    );
    let verdict = if life.conserved { "balanced" } else { "NOT BALANCED: run `authros audit verify`" };
    let lost = format!(
        "lost in transport {}, in the recorder {}, discarded {}; waiting in memory {}; deleted by retention {}",
        life.lost_in_transport, life.lost_in_recorder, life.discarded, life.waiting, life.deleted
    );
    let mut lines = vec![format!("{sum}: {verdict}"), lost];
    if right_ended > 0 {
        lines.push(format!(
            "unauthorised: {}, whose signer may not sign for the owner; resumed when the \
             administrator restores the account (`authros chain admin restore`) or the device is authorised again (`authros \
             robot authorise`)",
            counted(right_ended, "record")
        ));
    }
    if tampered > 0 {
        lines.push(format!("altered or MISSING: {}; see `authros audit`", counted(tampered, "record")));
    }
    lines
}

/// `alerts …`
#[derive(Debug, Subcommand)]
pub enum AlertsVerb {
    /// Active alerts, and deliveries still pending
    List,
    /// Send a test alert and print the reply
    Test,
}

pub fn plan(verb: &AlertsVerb) -> Plan {
    match verb {
        AlertsVerb::List => Plan::kept(ListAlerts),
        AlertsVerb::Test => Plan::kept(TestAlert),
    }
}

pub fn standing(view: &reply::AlertsView) -> String {
    let row = |alert: &reply::AlertView| {
        [alert.begun.in_milliseconds(), alert.severity.word().to_owned(), alert.key.clone(), alert.text.clone()]
    };
    let mut lines = match view.alerts.as_slice() {
        [] => vec!["no active alerts".to_owned()],
        alerts => vec![table(&["since", "severity", "alert", "what"], alerts.iter().map(row))],
    };
    lines.extend(view.over.iter().map(over));
    lines.push(format!("sent to: {}; deliveries pending: {}, dropped: {}", view.told, view.waiting, view.dropped));
    lines.join("\n")
}

pub fn over(ended: &reply::EndedAlert) -> String {
    format!(
        "resolved {}: {}, which began {}",
        ended.ended.in_milliseconds(),
        ended.alert.key,
        ended.alert.begun.in_milliseconds()
    )
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::service::reply::{HealthLevel, LifeLine, PartHealth, SiteView};

    fn view(level: HealthLevel, tampered: u64) -> SiteView {
        SiteView {
            health: vec![PartHealth::new("store", level, "")],
            life: LifeLine { tampered, conserved: true, ..LifeLine::default() },
            process: 0,
            robots: 0,
            profiles: Vec::new(),
            tasks: Vec::new(),
            queue: crate::service::reply::QueueView::default(),
            cache: None,
            verified_after: Vec::new(),
            alerts: Vec::new(),
            alerts_over: Vec::new(),
        }
    }

    #[test]
    fn the_exit_code_tells_of_the_worst_that_is_wrong() {
        let codes = |tampered| {
            [HealthLevel::Ok, HealthLevel::Absent, HealthLevel::Waiting, HealthLevel::Failed]
                .map(|level| code(&view(level, tampered)))
        };
        assert_eq!(codes(0), [0, 0, 4, 4]);
        assert_eq!(codes(1), [6, 6, 6, 6]);
        let mut lost = view(HealthLevel::Ok, 0);
        lost.life.conserved = false;
        assert_eq!(code(&lost), 6);
    }
}
