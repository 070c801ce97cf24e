//! `authros capture`: headless, ends when everything captured is verified.

use std::convert::Infallible;
use std::time::{Duration, Instant};

use super::connect::{Context, ProfileNeed};
use clap::Args;

use super::{parse, printed::TAMPERED, serve::until_done};
use crate::model::{ErrorKind, counted};
use crate::service::command::{Capture, ChainStatus, SiteStatus, StopCapture};
use crate::service::reply::{CaptureSummary, ChainView, HealthLevel, SiteView, TopicSummary};
use crate::service::{Client, Failure, Needs};
use authros_output::{Output, table};

/// Time without a verified record after which the wait is explained.
const QUIET: Duration = Duration::from_secs(20);
const LOOK: Duration = Duration::from_secs(3);

/// `capture …`
#[derive(Debug, Args)]
pub struct CaptureArguments {
    /// Topic to capture, or a pattern for those that the graph has now; repeatable
    #[arg(long = "topic", value_name = "TOPIC", required_unless_present = "of_robots")]
    pub topics: Vec<String>,
    /// Capture the topics that this robot has now, as robot1 for /robot1/**; repeatable
    #[arg(long = "robot", value_name = "NAME")]
    pub of_robots: Vec<String>,
    /// Reject messages of other types
    #[arg(long = "type", value_name = "TYPE")]
    pub type_name: Option<String>,
    /// Stop after this many messages per topic
    #[arg(long, value_name = "N", conflicts_with = "duration")]
    pub count: Option<u64>,
    /// Stop after this time: 10s, 5m, 1h
    #[arg(long = "for", value_name = "TIME", id = "duration")]
    pub duration: Option<String>,
    /// Tag, sealed with each record, such as mission=harbour; repeatable
    #[arg(long = "tag", value_name = "KEY=VALUE")]
    pub tags: Vec<String>,
}

pub async fn run(context: Context, arguments: CaptureArguments, output: &Output) -> Result<u8, Failure> {
    let length = arguments.duration.as_deref().map(parse::duration).transpose()?;
    let topics = parse::topics(&arguments.topics, &arguments.of_robots)?;
    let type_name = parse::optional(arguments.type_name.as_deref())?;
    let milliseconds = length.map(|length| u64::try_from(length.as_millis()).unwrap_or(u64::MAX));
    let tags = parse::tags(&arguments.tags)?;
    let ask = Capture { topics, type_name, count: arguments.count, milliseconds, tags };
    let connection = context.connect(Needs { ros: true, chain: true }).await?;
    let result = async {
        context.prepare(&connection.client, ProfileNeed::Made, output).await?;
        let client = &connection.client;
        let words = (
            "capture stopped; waiting until everything is verified",
            "stopped before everything captured was verified; it is stored and continues at the next start",
        );
        until_done(client, ask, StopCapture, words, output, tell_what_it_waits_for(client, output)).await
    };
    let result = result.await;
    match &result {
        Ok(_) => connection.close().await,
        Err(_) => connection.end().await,
    }
    let summary = result?;
    output.result(&summary, || text(&summary));
    Ok(code(&summary, output))
}

/// Explains why nothing gets verified, each cause once. Never ends.
async fn tell_what_it_waits_for(client: &Client, output: &Output) -> Infallible {
    let (mut verified, mut block) = ((0, Instant::now()), (0, Instant::now()));
    let mut told = None;
    loop {
        tokio::time::sleep(LOOK).await;
        let (Ok(site), Ok(chain)) = (client.ask(SiteStatus).await, client.ask(ChainStatus).await) else { continue };
        for (seen, now) in [(&mut verified, site.life.verified), (&mut block, chain.block)] {
            if seen.0 != now {
                *seen = (now, Instant::now());
            }
        }
        if site.life.pending == 0 || verified.1.elapsed() < QUIET {
            if site.life.pending == 0 {
                verified.1 = Instant::now();
            }
            told = None;
            continue;
        }
        let (cause, text) = obstacle(&site, &chain, block.1.elapsed());
        if told.replace(cause) != Some(cause) {
            output.note(&format!("waiting, {} not verified yet: {text}", counted(site.life.pending, "record")));
        }
    }
}

/// The cause and its explanation; `still` is the time since the last block.
fn obstacle(site: &SiteView, chain: &ChainView, still: Duration) -> (&'static str, String) {
    let unwell = site.health.iter().find(|part| part.part == "chain" && part.level != HealthLevel::Ok);
    if let Some(part) = unwell {
        return ("chain", part.text.clone());
    }
    if still >= QUIET {
        let (block, seconds) = (chain.block, still.as_secs());
        let advice = "check that its signers or miners run";
        return ("block", format!("the chain has had no block after {block} for {seconds} s; {advice}"));
    }
    match chain.waiting.first() {
        Some(next) => {
            let what = format!("{} with nonce {} at {} per gas", next.purpose, next.nonce, next.price);
            let advice = "check that the network makes blocks; see `authros chain status`";
            (
                "transaction",
                format!("{} in no block yet, first {what}; {advice}", counted(chain.pending, "transaction")),
            )
        }
        None => ("progress", "the site is working through them; see `authros status`".to_owned()),
    }
}

fn text(summary: &CaptureSummary) -> String {
    let row = |topic: &TopicSummary| {
        let figures = [topic.captured, topic.verified, topic.quarantined, topic.lost].map(|count| count.to_string());
        let type_name = topic.type_name.clone().unwrap_or_else(|| "never seen".to_owned());
        [vec![topic.topic.clone(), type_name], figures.to_vec()].concat()
    };
    let head = ["topic", "type", "captured", "verified", "quarantined", "lost"];
    table(&head, summary.topics.iter().map(row))
}

fn code(summary: &CaptureSummary, output: &Output) -> u8 {
    if summary.verified + summary.quarantined < summary.captured {
        output.note(TAMPERED);
        return ErrorKind::Tampered.exit_code();
    }
    for topic in &summary.topics {
        let unreached = topic.unreached.iter();
        unreached.for_each(|one| output.note(&format!("authros: {} was not read from {one}", topic.topic)));
    }
    let told = [
        (summary.quarantined, "quarantined, because the publisher is not pinned; see `authros topics quarantine list`"),
        (summary.lost, "lost before capture; the loss is recorded"),
        (summary.skipped, "of a different type than requested, so not captured"),
    ];
    for (count, what) in told.into_iter().filter(|(count, _)| *count > 0) {
        output.note(&format!("authros: {} {what}", counted(count, "message")));
    }
    let unseen: Vec<&TopicSummary> = summary.topics.iter().filter(|topic| topic.captured == 0).collect();
    let unknown = unseen.iter().filter(|topic| topic.unreached.is_empty() && summary.skipped == 0);
    let unknown: Vec<&str> = unknown.map(|topic| topic.topic.as_str()).collect();
    if !unknown.is_empty() {
        let advice = "check its name with `authros topics list`";
        output.note(&format!("authros: nothing arrived on {}; {advice}", unknown.join(", ")));
    }
    let whole = unseen.is_empty() && summary.lost + summary.quarantined + summary.skipped == 0;
    if whole { 0 } else { ErrorKind::Incomplete.exit_code() }
}
