//! `authros serve`: the site without a console.

use std::sync::OnceLock;

use clap::Args;
use tokio::signal::unix::{SignalKind, signal};
use tokio::sync::broadcast;

use super::connect::{Context, ProfileNeed};
use crate::service::command::{ChainStatus, Register};
use crate::service::event::NoticeLevel;
use crate::service::{Event, Failure, Needs};
use authros_output::Output;

/// `serve …`
#[derive(Debug, Args)]
pub struct ServeArguments {
    /// Run in a process of its own that outlives this terminal; return when it serves
    #[arg(long)]
    pub detach: bool,
    /// Set by --detach: leave the session of the terminal
    #[arg(long, hide = true, conflicts_with = "detach")]
    pub own_session: bool,
}

/// Whether the parent wants this process to outlive its terminal (nohup), judged by its signals at the start.
static KEEPS_ON: OnceLock<bool> = OnceLock::new();

/// Checks whether SIGHUP is ignored; to be called before anything listens to signals.
pub fn note_hangup() {
    let status = std::fs::read_to_string("/proc/self/status").unwrap_or_default();
    KEEPS_ON.get_or_init(|| ignores_hangup(&status));
}

/// SIGHUP is the lowest bit of the mask.
fn ignores_hangup(status: &str) -> bool {
    let mask = status.lines().find_map(|line| line.strip_prefix("SigIgn:"));
    mask.and_then(|mask| u64::from_str_radix(mask.trim(), 16).ok()).is_some_and(|mask| mask & 1 == 1)
}

/// How a process was asked to end.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Ending {
    /// SIGINT: by a person, who can wait and can ask again.
    Asked,
    /// SIGTERM or SIGHUP: now.
    Ordered,
}

/// Waits for SIGINT, SIGTERM, or SIGHUP unless that is ignored.
pub async fn asked_to_end() -> Ending {
    let wait = |kind| async move {
        match signal(kind) {
            Ok(mut stream) => drop(stream.recv().await),
            Err(_) => std::future::pending().await,
        }
    };
    let hangup = async {
        match KEEPS_ON.get() {
            Some(true) => std::future::pending().await,
            _ => wait(SignalKind::hangup()).await,
        }
    };
    tokio::select! {
        () = wait(SignalKind::interrupt()) => Ending::Asked,
        () = wait(SignalKind::terminate()) => Ending::Ordered,
        () = hangup => Ending::Ordered,
    }
}

/// Runs the site until a signal ends it.
///
/// # Errors
/// If another process is the site already, or the profile cannot be opened.
pub async fn run(context: Context, arguments: ServeArguments, output: &Output) -> Result<u8, Failure> {
    if arguments.detach {
        return tokio::task::block_in_place(|| super::detach::run(&context, output));
    }
    if arguments.own_session {
        // Fails only for a leader of a group, which has left its terminal's already.
        rustix::process::setsid().ok();
    }
    let connection = context.open(Needs { ros: true, chain: true }, output).await.map_err(not_started)?;
    connection.oversee();
    // Problems during startup are shown too.
    let events = connection.client.events();
    // If it worked here before, no chain is needed to start.
    let known = context.home.pin().exists() && context.home.keyring(&context.profile).exists();
    let prepared = async {
        context.prepare(&connection.client, ProfileNeed::Made, output).await?;
        connection.client.ask(Register).await
    };
    // Listened to from here to the end, so that no signal is missed in between.
    let end = asked_to_end();
    tokio::pin!(end);
    let ended = tokio::select! {
        prepared = prepared => prepared,
        _ = &mut end => {
            connection.end().await;
            return Ok(0);
        }
    };
    match ended {
        Ok(_) => {}
        // Whatever is wrong with the chain, what is captured meanwhile is kept.
        Err(failure) if known && connection.client.ask(ChainStatus).await.is_err() => {
            output.note(&format!("authros: {}; capture goes on without the chain", failure.message));
        }
        Err(failure) => {
            connection.end().await;
            return Err(not_started(failure));
        }
    }
    let master = match &connection.site {
        Some(site) if context.config.ros_master.is_none() => site.ros_uri().await.ok(),
        _ => context.config.ros_master.clone(),
    };
    let root = context.home.root().display().to_string();
    let ready = serde_json::json!({ "serving": root, "profile": context.profile, "ros_master": master });
    output.result(&ready, || {
        let ros = master.map_or_else(String::new, |uri| format!("\nROS nodes join with ROS_MASTER_URI={uri}"));
        format!("serving {root} for profile '{}'; stop it with Ctrl-C{ros}", context.profile)
    });
    let ready = super::systemd::ready();
    follow(events, output, end).await;
    drop(ready);
    connection.end().await;
    Ok(0)
}

/// Nothing continues by itself if nothing runs.
fn not_started(failure: Failure) -> Failure {
    let message = format!("the site did not start: {}", failure.message);
    Failure::new(failure.kind, message)
}

/// Shows the site's warnings until `end`, or the site's end, including those since `events` were subscribed to.
pub async fn follow(mut events: broadcast::Receiver<Event>, output: &Output, end: impl Future<Output = Ending>) {
    tokio::pin!(end);
    loop {
        tokio::select! {
            _ = &mut end => return,
            event = events.recv() => match event {
                Ok(Event::Notice { at, level, text, about }) if level >= NoticeLevel::Warning || about.is_some() => {
                    output.notice(at, level, about.as_deref(), &text);
                }
                Ok(_) | Err(broadcast::error::RecvError::Lagged(_)) => {}
                Err(broadcast::error::RecvError::Closed) => return,
            },
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn only_an_ignored_hangup_is_one() {
        assert!(ignores_hangup("Name:\tauthros\nSigIgn:\t0000000000001001\n"));
        assert!(!ignores_hangup("Name:\tauthros\nSigIgn:\t0000000000001000\n"));
        assert!(!ignores_hangup("SigIgn:\tnonsense\n"));
        assert!(!ignores_hangup(""));
    }
}
