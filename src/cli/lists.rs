//! Results as text for people.

use super::{connect::Context, parties};
use crate::config::SettingView;
use crate::crypto::{Fingerprint, read_public};
use crate::model::{Address, ProfileName, Verdict};
use crate::pipeline::{columns::Compared, sender::LaneState};
use crate::service::{Failure, reply};
use authros_output::{Output, pairs, table};

fn yes(value: bool) -> String {
    if value { "yes" } else { "no" }.to_owned()
}

pub fn or_dash<T: ToString>(value: Option<T>) -> String {
    value.map_or_else(|| "-".to_owned(), |value| value.to_string())
}

pub fn verdict(view: &reply::CheckView) -> String {
    let reason = view.reason.as_ref().map_or_else(String::new, |reason| format!(": {reason}"));
    format!("{}: {}{reason}", view.id, view.verdict.word())
}

pub fn verdict_code(verdict: Verdict) -> u8 {
    match verdict {
        Verdict::Verified | Verdict::Unanchored | Verdict::Deleted => 0,
        Verdict::NotChecked => crate::model::ErrorKind::Incomplete.exit_code(),
        Verdict::Tampered | Verdict::Missing => crate::model::ErrorKind::Tampered.exit_code(),
        Verdict::NoKey => crate::model::ErrorKind::Refused.exit_code(),
    }
}

pub fn settings(settings: &[SettingView]) -> String {
    let row = |setting: &SettingView| {
        [setting.name.to_owned(), setting.value.clone(), setting.source.clone(), setting.text.to_owned()]
    };
    table(&["setting", "value", "from", "meaning"], settings.iter().map(row))
}

pub fn profiles(context: &Context, output: &Output) -> u8 {
    let all = context.home.profiles();
    let is_used = |profile: &ProfileName| *profile == context.profile;
    let json: Vec<serde_json::Value> =
        all.iter().map(|profile| serde_json::json!({ "profile": profile, "used": is_used(profile) })).collect();
    let line = |profile: &ProfileName| format!("{} {profile}", if is_used(profile) { "*" } else { " " });
    output.result(&json, || match all.as_slice() {
        [] => "no profile yet; create one with authros identity create".to_owned(),
        all => all.iter().map(line).collect::<Vec<_>>().join("\n"),
    });
    0
}

pub fn identities(context: &Context, output: &Output) -> Result<u8, Failure> {
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
            return "no identity yet; create one with authros identity create".to_owned();
        }
        let line = |(used, profile, address, fingerprint): &(bool, ProfileName, Address, String)| {
            let mark = if *used { "*" } else { " " };
            [format!("{mark} {profile}"), address.to_string(), fingerprint.clone()]
        };
        table(&["  profile", "address", "fingerprint"], rows.iter().map(line))
    });
    Ok(0)
}

pub fn identity(view: &reply::IdentityView) -> String {
    pairs(&[
        ("profile", view.profile.to_string()),
        ("exists", yes(view.exists)),
        ("registered", yes(view.registered)),
        ("address", or_dash(view.address)),
        ("epoch", or_dash(view.epoch)),
        ("fingerprint", or_dash(view.fingerprint.as_ref())),
        ("signing key", or_dash(view.signing_key)),
        ("envelope key", or_dash(view.envelope_key)),
    ])
}

pub fn keys(view: &reply::KeysView) -> String {
    let head = pairs(&[
        ("EOA", view.address.to_string()),
        ("SM2 signing", view.signing_fingerprint.clone()),
        ("SM2 envelope", view.envelope_fingerprint.clone()),
    ]);
    let rows = view.epochs.iter().map(|epoch| {
        let state = if epoch.current { "current" } else { "past" };
        [epoch.epoch.to_string(), state.to_owned(), epoch.token.to_string()]
    });
    format!("{head}\n\n{}", table(&["epoch", "state", "token"], rows))
}

/// Shows a topic's ROS only where there are topics of ROS 2.
pub fn topics(rows: &[reply::TopicRow]) -> String {
    let second = rows.iter().any(|row| row.ros == 2);
    let row = |row: &reply::TopicRow| {
        let mut cells = vec![row.topic.clone()];
        cells.extend(second.then(|| row.ros.to_string()));
        cells.extend([
            or_dash(row.type_name.as_ref()),
            row.publishers.join(" "),
            or_dash(row.hz.map(|hz| format!("{hz:.1}"))),
            if row.left_out > 0 { format!("{} left out", row.left_out) } else { String::new() },
            if row.watched { "watched" } else { "" }.to_owned(),
            if row.alarm { "ALARM" } else { "" }.to_owned(),
            if row.simulated { "SIMULATED" } else { "" }.to_owned(),
        ]);
        cells
    };
    let mut head = vec!["topic", "type", "publishers", "Hz", "", "", "", ""];
    if second {
        head.insert(1, "ROS");
    }
    let unreached = |row: &reply::TopicRow| {
        let topic = row.topic.clone();
        row.unreached.clone().into_iter().map(move |one| format!("\n{topic} is not read from {one}"))
    };
    table(&head, rows.iter().map(row)) + &rows.iter().flat_map(unreached).collect::<String>()
}

pub fn records(page: &reply::RecordPage) -> String {
    let row = |record: &reply::RecordView| {
        [
            record.id.clone(),
            record.seq.to_string(),
            record.topic.clone(),
            record.state.word().to_owned(),
            record.bytes.to_string(),
            record.captured_at.in_milliseconds(),
            or_dash(record.block),
            if record.simulated { "SIMULATED" } else { "" }.to_owned(),
            record.owner.map(|owner| parties::named(owner, record.owner_name.as_ref())).unwrap_or_default(),
        ]
    };
    let shared = page.records.iter().any(|record| record.owner.is_some());
    let owner = if shared { "owner" } else { "" };
    let head = ["id", "seq", "topic", "state", "bytes", "captured", "block", "", owner];
    let list = table(&head, page.records.iter().map(row));
    let mut lines = vec![list];
    lines.extend(doubts(page));
    lines.extend(page.records.iter().filter_map(|record| Some(format!("{} {}", record.id, record.erased.as_ref()?))));
    lines.extend(page.next.as_ref().map(|next| format!("more: --after {next}")));
    lines.extend(page.arriving.as_ref().map(|arriving| format!("{arriving}; this is what is here so far")));
    lines.join("\n")
}

/// Parts of a page that only the ledger states, or that contradict the records.
fn doubts(page: &reply::RecordPage) -> Vec<String> {
    let count = |is: &dyn Fn(&reply::RecordView) -> bool| page.records.iter().filter(|record| is(record)).count();
    let differs = |record: &reply::RecordView| Some(format!("{} ({})", record.id, record.differs.as_ref()?));
    let altered: Vec<String> = page.records.iter().filter_map(differs).collect();
    let misnamed = count(&|record| record.state == reply::ShownState::Refused(reply::Refusal::FalseName));
    let unread = count(&|record| record.state == reply::ShownState::Verified(reply::Caveat::Unread));
    let sealed = count(&|record| record.compared == Compared::Header);
    let mut lines = Vec::new();
    if !altered.is_empty() {
        let which = altered.join(", ");
        lines.push(format!(
            "the ledger was altered; the values from the records themselves are shown: {which}; run `authros audit`"
        ));
    }
    if misnamed > 0 {
        lines.push(format!(
            "false name: the signers of {misnamed} wrote names into them that belong to other pseudonyms; what they wrote is \
             not shown, `authros uploads show ID` names the signer"
        ));
    }
    if unread > 0 {
        lines.push(format!("unread: the bytes of {unread} are not here, so the ledger's values were not compared"));
    }
    if sealed > 0 {
        lines.push(format!(
            "topic, type, bytes and SIMULATED of {sealed} are only the ledger's claim: they are sealed, and no keyring \
             is open"
        ));
    }
    lines
}

pub fn provenance(view: &reply::Provenance) -> String {
    let record = &view.record;
    let mut rows = vec![("id", record.id.clone()), ("topic", record.topic.clone()), ("type", record.type_name.clone())];
    rows.extend(view.steps.iter().map(|(word, text)| (word.as_str(), text.clone())));
    pairs(&rows)
}

pub fn grants(rows: &[reply::GrantRow]) -> String {
    let row = |row: &reply::GrantRow| {
        [
            row.direction.word().to_owned(),
            parties::named(
                if row.direction == reply::Direction::Given { row.grantee } else { row.owner },
                row.name.as_ref(),
            ),
            or_dash(row.fingerprint.as_ref()),
            row.state.word().to_owned(),
            if row.earlier == Some(true) { format!("{} and earlier", row.epoch) } else { row.epoch.to_string() },
            or_dash(row.expires),
            if row.topics.is_empty() { "all topics".to_owned() } else { row.topics.join(" ") },
        ]
    };
    let head = ["", "account", "SM2 fingerprint", "state", "epoch", "expires", "topics"];
    table(&head, rows.iter().map(row))
}

pub fn chain(view: &reply::ChainView) -> String {
    let paused = |lane: &LaneState| lane.paused.as_ref().map(|reason| ("paused", reason.text(lane.account)));
    let mut rows = vec![
        ("kind", view.kind.clone()),
        ("client", view.client.clone()),
        ("consensus", view.consensus.clone()),
        ("chain id", view.chain_id.to_string()),
        ("genesis", view.genesis.to_string()),
        ("block", view.block.to_string()),
        ("contract", or_dash(view.contract)),
        ("balance", format!("{} wei", view.balance)),
        ("nonce", view.nonce.to_string()),
        ("pending", view.pending.to_string()),
        ("chain.min_price", format!("{} per gas", view.prices.min_price)),
        ("chain.max_fee", view.prices.max_fee.map_or_else(|| "no cap".to_owned(), |cap| format!("{cap} per gas"))),
        ("period", or_dash(view.sealing.period.map(|period| format!("at least {period} ms between blocks")))),
        ("difficulty", or_dash(view.sealing.difficulty.as_ref().map(|hashes| format!("{hashes} hashes per block")))),
        ("sealers", listed(&view.sealing.sealers)),
    ];
    rows.extend(view.through.clone().map(|text| ("seen", text)));
    rows.extend(parties::administration(&view.administration));
    let waits = |one: &reply::WaitingView| {
        let is_first = view.lanes.first().is_none_or(|lane| lane.account == one.account);
        let of = if is_first { String::new() } else { format!(" of {}", one.account) };
        ("waits", format!("nonce {}{of}: {}, at {} per gas", one.nonce, one.purpose, one.price))
    };
    rows.extend(view.waiting.iter().map(waits));
    rows.extend(view.lacks.map(|shortfall| ("lacks", shortfall.to_string())));
    rows.extend(view.lanes.iter().filter_map(paused));
    pairs(&rows)
}

fn listed(accounts: &[Address]) -> String {
    let listed: Vec<String> = accounts.iter().map(Address::to_string).collect();
    or_dash((!listed.is_empty()).then(|| listed.join(" ")))
}

pub fn deployed(view: &reply::DeployedView) -> String {
    pairs(&[
        ("contract", view.pin.contract.to_string()),
        ("administrator", view.administrator.to_string()),
        ("chain id", view.pin.chain_id.to_string()),
        ("genesis", view.pin.genesis.to_string()),
        ("block", view.pin.deployed_at.to_string()),
        ("code hash", view.pin.code_hash.to_string()),
    ])
}
