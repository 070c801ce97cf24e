//! `records list --follow`, `received list --follow`: one line per record whenever its state changes.

use std::{collections::HashMap, time::Duration};

use super::connect::{Context, ProfileNeed};
use crate::model::Timestamp;
use crate::service::reply::{RecordPage, RecordView, ShownState};
use crate::service::{Client, Event, Failure, Needs, Part, UploadQuery, command::Ask};
use authros_output::Output;

/// Records older than this, measured from the newest, are no longer followed; nanoseconds.
const WINDOW: u64 = 60_000_000_000;

pub async fn run<A: Ask<Answer = RecordPage>>(
    context: Context,
    list: fn(UploadQuery) -> A,
    query: UploadQuery,
    output: &Output,
) -> Result<u8, Failure> {
    let connection = context.connect(Needs { ros: true, chain: true }).await?;
    let followed = async {
        context.prepare(&connection.client, ProfileNeed::Unlocked, output).await?;
        follow(&connection.client, list, query, output).await
    };
    let followed = tokio::select! {
        followed = followed => followed,
        _ = super::serve::asked_to_end() => Ok(()),
    };
    connection.end().await;
    followed.map(|()| 0)
}

async fn follow<A: Ask<Answer = RecordPage>>(
    client: &Client,
    list: fn(UploadQuery) -> A,
    mut query: UploadQuery,
    output: &Output,
) -> Result<(), Failure> {
    let mut events = client.events();
    let mut told: HashMap<String, (Timestamp, ShownState)> = HashMap::new();
    query.newest_first = false;
    let begin = query.since;
    loop {
        let newest = told.values().map(|(at, _)| *at).max();
        query.since = newest.map(|at| Timestamp(at.0.saturating_sub(WINDOW))).max(begin);
        query.after = None;
        loop {
            let page = client.ask(list(query.clone())).await?;
            page.records.iter().for_each(|record| tell(record, &mut told, output));
            query.after = page.next;
            if query.after.is_none() {
                break;
            }
        }
        if let Some(newest) = newest {
            told.retain(|_, (at, _)| at.0 + 2 * WINDOW > newest.0);
        }
        wait(&mut events).await;
    }
}

fn tell(record: &RecordView, told: &mut HashMap<String, (Timestamp, ShownState)>, output: &Output) {
    let known = told.insert(record.id.clone(), (record.captured_at, record.state));
    if known.is_none_or(|(_, state)| state != record.state) {
        output
            .result(record, || format!("{}  {:10}  {}  {}", record.id, record.state.word(), record.topic, record.seq));
    }
}

async fn wait(events: &mut tokio::sync::broadcast::Receiver<Event>) {
    let changed = async {
        while let Ok(event) = events.recv().await {
            if event == (Event::Changed { part: Part::Uploads }) {
                return;
            }
        }
    };
    drop(tokio::time::timeout(Duration::from_secs(1), changed).await);
}
