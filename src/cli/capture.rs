//! `authros capture`: headless, ends when everything captured is verified.

use super::args::CaptureArguments;
use super::connect::{Context, ProfileNeed};
use super::parse;
use super::serve::Ending;
use crate::model::ErrorKind;
use crate::service::command::{Capture, StopCapture};
use crate::service::reply::CaptureSummary;
use crate::service::{Client, Failure, Needs};
use authros_output::{Output, table};

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
    let answer = client.ask(ask);
    tokio::pin!(answer);
    let mut asked = false;
    loop {
        tokio::select! {
            summary = &mut answer => return summary,
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
    let unseen: Vec<&str> =
        summary.topics.iter().filter(|topic| topic.captured == 0).map(|topic| topic.topic.as_str()).collect();
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
        } else if !unseen.is_empty() {
            output.note(&format!(
                "authros: nothing arrived on {}; check its name with `authros topics list`",
                unseen.join(", ")
            ));
        }
        return ErrorKind::Incomplete.exit_code();
    }
    0
}
