//! The Chain screen.

use crate::app::{Feed, State};
use crate::model::{Address, counted};
use crate::pipeline::sender::LaneState;
use crate::service::reply::{AdministrationView, ChainView, GasView};
use crate::ui::{Canvas, Fact, Rect, Role, below, draw_facts, empty, facts::draw_fact, row, words};

pub fn draw(canvas: &mut Canvas, area: Rect, state: &State) {
    canvas.put(area, "Chain", Role::Title);
    let area = below(area, 1);
    match &state.chain {
        Some(chain) => draw_known(canvas, area, state, chain),
        None => drop(canvas.put_wrapped(area, empty(state, Feed::Chain, "Asking…"), Role::Dim)),
    }
}

fn draw_known(canvas: &mut Canvas, area: Rect, state: &State, chain: &ChainView) {
    let contract = chain.contract.map_or_else(|| "not deployed yet".to_owned(), |contract| contract.to_string());
    let kind =
        chain.through.as_ref().map_or_else(|| chain.kind.clone(), |through| format!("{}, {through}", chain.kind));
    let lines = [
        ("Kind", kind),
        ("Node", chain.client.clone()),
        ("Consensus", format!("{}{}", chain.consensus, sealing(chain))),
        ("Chain id", chain.chain_id.to_string()),
        ("Genesis", chain.genesis.to_string()),
        ("Block", words::count(chain.block)),
        ("Contract", contract),
        ("Address", state.address().map_or_else(|| "no identity yet".to_owned(), |address| address.to_string())),
        ("Balance", ether(&chain.balance)),
        ("Next nonce", chain.nonce.to_string()),
        ("Pending", format!("{} of your transactions not in a block yet", words::count(chain.pending))),
        ("Gas", gas(&chain.gas)),
        ("Admin", administrator(state, &chain.administration)),
    ];
    let taken = draw_facts(canvas, area, &lines.map(|(label, value)| (label, value, Role::Body))) + 1;
    let told = draw_facts(canvas, below(area, taken), &decisions(&chain.administration));
    let lanes = told + draw_lanes(canvas, below(area, taken + told), &chain.lanes);
    if let Some(failure) = &state.feeds.slot(Feed::Chain).failure {
        canvas.put_wrapped(below(area, taken + 1 + lanes), &failure.message, Role::Bad);
    }
}

fn decisions(decided: &AdministrationView) -> Vec<Fact> {
    let shown = |account: Address, name: &Option<String>| name.clone().unwrap_or_else(|| account.to_string());
    let paused = decided.paused.then(|| {
        let end = decided.paused_until.map_or_else(String::new, |until| format!(", until {until}"));
        ("Paused", format!("by the administrator: no changes except revokes{end}"), Role::Warning)
    });
    let proposals = decided.proposals.iter().map(|one| {
        let (lost, successor) = (shown(one.lost, &one.lost_name), shown(one.successor, &one.successor_name));
        ("Proposed", format!("{successor} for {lost}, from {} on", one.due), Role::Warning)
    });
    let successions = decided.successions.iter().map(|one| {
        let (lost, successor) = (shown(one.lost, &one.lost_name), shown(one.successor, &one.successor_name));
        ("Successor", format!("{successor} for {lost}, lost"), Role::Warning)
    });
    paused.into_iter().chain(proposals).chain(successions).collect()
}

/// Returns the rows taken.
fn draw_lanes(canvas: &mut Canvas, area: Rect, lanes: &[LaneState]) -> u16 {
    let mut place = 0;
    for (number, lane) in (1..).zip(lanes) {
        let what = format!("{}  {} pending", lane.account, lane.open);
        draw_fact(canvas, row(area, place), &format!("Lane {number}"), &what, Role::Body);
        place += 1;
        if let Some(paused) = &lane.paused {
            canvas.put(row(area, place), &format!("  paused: {}", paused.cause(lane.account)), Role::Bad);
            place += 1;
        }
    }
    place
}

/// Per record, over the newest transactions.
fn gas(view: &GasView) -> String {
    if view.records == 0 {
        return "nothing anchored yet".to_owned();
    }
    let each = view.gas / view.records;
    let (transactions, records) = (counted(view.transactions, "transaction"), counted(view.records, "record"));
    format!("{} per record ({records} in the last {transactions})", words::count(each))
}

fn administrator(state: &State, decided: &AdministrationView) -> String {
    let Some(administrator) = decided.administrator else { return "not known yet".to_owned() };
    let whose = if Some(administrator) == state.address() { "you; press : for your commands" } else { "not you" };
    let registration = if decided.open { "anyone can register" } else { "only allowed accounts can register" };
    format!("{} ({whose}), {registration}", administrator.short())
}

fn sealing(chain: &ChainView) -> String {
    let sealing = &chain.sealing;
    let mut parts = Vec::new();
    parts.extend(sealing.period.map(|period| format!("at least {period} ms between blocks")));
    parts.extend(sealing.difficulty.as_ref().map(|difficulty| format!("difficulty {difficulty}")));
    if chain.consensus == "poa" && !sealing.sealers.is_empty() {
        let signers = if sealing.sealers.len() == 1 { "signer" } else { "signers" };
        parts.push(format!("{} {signers}", sealing.sealers.len()));
    }
    if parts.is_empty() { String::new() } else { format!(", {}", parts.join(", ")) }
}

/// Wei as ether, if it is a round number of at least a millionth.
fn ether(wei: &str) -> String {
    const DIGITS: usize = 18;
    if wei.len() + 6 <= DIGITS || !wei.bytes().all(|digit| digit.is_ascii_digit()) {
        return format!("{wei} wei");
    }
    let padded = format!("{wei:0>width$}", width = DIGITS + 1);
    let (whole, part) = padded.split_at(padded.len() - DIGITS);
    format!("{whole}.{} ether", &part[..6])
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn balances_read_as_ether() {
        assert_eq!(ether("0"), "0 wei");
        assert_eq!(ether("1500000000000000000"), "1.500000 ether");
        assert_eq!(ether("1234567890123"), "0.000001 ether");
        assert_eq!(ether("100000000000000000000"), "100.000000 ether");
        assert_eq!(ether("many"), "many wei");
    }
}
