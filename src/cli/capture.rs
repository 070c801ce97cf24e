//! `authros capture`: headless, ends when everything captured is verified.

use std::time::{Duration, Instant};

use super::args::CaptureArguments;
use super::connect::{Context, ProfileNeed};
use super::parse;
use super::serve::Ending;
use crate::model::ErrorKind;
use crate::service::command::{Capture, ChainStatus, SiteStatus, StopCapture};
use crate::service::reply::{CaptureSummary, ChainView, HealthLevel, SiteView, TopicSummary};
use crate::service::{Client, Failure, Needs};
use authros_output::{Output, table};

/// Without a verified record for this long, the person is told what the capture waits for.
const QUIET: Duration = Duration::from_secs(20);
/// How often to look.
const LOOK: Duration = Duration::from_secs(3);

/// Runs one capture; Ctrl-C ends it early, a second one exits at once.
///
/// # Errors
/// Errors of the site or the arguments.
pub async fn run(context: Context, arguments: CaptureArguments, output: &Output) -> Result<u8, Failure> {
    let tags: Result<Vec<_>, Failure> = arguments.tags.iter().map(|text| parse::tag(text)).collect();
    let length = arguments.duration.as_deref().map(parse::duration).transpose()?;
    let ask = Capture {
        topics: parse::values(&arguments.topics)?,
        type_name: arguments.type_name.as_deref().map(parse::value).transpose()?,
        count: arguments.count,
        milliseconds: length.map(|length| u64::try_from(length.as_millis()).unwrap_or(u64::MAX)),
        tags: tags?,
    };
    let connection = context.connect(Needs { ros: true, chain: true }).await?;
    let result = async {
        context.prepare(&connection.client, ProfileNeed::Made, output).await?;
        until_done(&connection.client, ask, output).await
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

async fn until_done(client: &Client, ask: Capture, output: &Output) -> Result<CaptureSummary, Failure> {
    let (answer, waiting) = (client.ask(ask), tell_what_it_waits_for(client, output));
    tokio::pin!(answer, waiting);
    let mut asked = false;
    loop {
        tokio::select! {
            summary = &mut answer => return summary,
            () = &mut waiting => {}
            ending = crate::cli::serve::asked_to_end() => {
                if asked || ending == Ending::Ordered {
                    return Err(Failure::new(ErrorKind::Incomplete, "stopped before everything captured was verified; \
                                                                    it is stored and continues at the next start"));
                }
                asked = true;
                output.note("capture stopped; waiting until everything is verified (Ctrl-C again to quit now)");
                client.ask(StopCapture).await?;
            }
        }
    }
}

/// While records are captured and none gets verified: says why, as far as the site knows; each cause once. Never ends.
async fn tell_what_it_waits_for(client: &Client, output: &Output) {
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
            output.note(&format!("waiting, {} records are not verified yet: {text}", site.life.pending));
        }
    }
}

/// Why nothing gets verified: a word for the cause, and what to say. `still` is the time since the last block.
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
            ("transaction", format!("{} transactions are in no block yet, first {what}; {advice}", chain.pending))
        }
        None => ("progress", "the site is working through them; see `authros status`".to_owned()),
    }
}

fn text(summary: &CaptureSummary) -> String {
    let rows: Vec<Vec<String>> = summary
        .topics
        .iter()
        .map(|topic| {
            let type_name = topic.type_name.clone().unwrap_or_else(|| "never seen".to_owned());
            vec![
                topic.topic.clone(),
                type_name,
                topic.captured.to_string(),
                topic.verified.to_string(),
                topic.quarantined.to_string(),
                topic.lost.to_string(),
            ]
        })
        .collect();
    table(&["topic", "type", "captured", "verified", "quarantined", "lost"], &rows)
}

fn code(summary: &CaptureSummary, output: &Output) -> u8 {
    if summary.verified + summary.quarantined < summary.captured {
        output.note(
            "authros: some records differ from what was anchored; `authros uploads list --state tampered` lists them",
        );
        return ErrorKind::Tampered.exit_code();
    }
    let unseen: Vec<&TopicSummary> = summary.topics.iter().filter(|topic| topic.captured == 0).collect();
    for topic in &summary.topics {
        topic
            .unreached
            .iter()
            .for_each(|one| output.note(&format!("authros: {} was not read from {one}", topic.topic)));
    }
    if !unseen.is_empty() || summary.lost > 0 || summary.quarantined > 0 || summary.skipped > 0 {
        if summary.quarantined > 0 {
            output.note(&format!(
                "authros: {} messages are quarantined because their publisher is not pinned; see `authros quarantine \
                 list`",
                summary.quarantined
            ));
        }
        if summary.lost > 0 {
            output.note(&format!("authros: {} messages were lost before capture; the loss is recorded", summary.lost));
        }
        if summary.skipped > 0 {
            output.note(&format!(
                "authros: {} messages have a different type than requested and were not captured",
                summary.skipped
            ));
        } else {
            let unknown: Vec<&str> =
                unseen.iter().filter(|topic| topic.unreached.is_empty()).map(|topic| topic.topic.as_str()).collect();
            if !unknown.is_empty() {
                output.note(&format!(
                    "authros: nothing arrived on {}; check its name with `authros topics list`",
                    unknown.join(", ")
                ));
            }
        }
        return ErrorKind::Incomplete.exit_code();
    }
    0
}
