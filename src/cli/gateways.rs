//! `shared gateways`: what each gateway lacks, for people, and the exit code.

use clap::Args;

use super::parse;
use crate::model::{Address, ErrorKind, RecorderId};
use crate::service::Failure;
use crate::service::command::CompareGateways;
use crate::service::reply::{GatewayHoldings, GatewaysView, HoleView, LackView};
use authros_output::table;

/// The most ranges told of a topic.
const MOST_RANGES: usize = 20;
/// The most lines told of a gateway, and of what nobody has.
const MOST_LINES: usize = 50;
/// Characters of a recorder's id.
const SHORT: usize = 8;

/// `shared gateways`
#[derive(Debug, Args)]
pub struct GatewaysArguments {
    /// Only records of this owner, by account or name
    #[arg(long, value_name = "ADDRESS_OR_NAME")]
    owner: Option<String>,
    /// Only this topic
    #[arg(long, value_name = "TOPIC")]
    topic: Option<String>,
    /// Each record is to be at this many gateways [default: at all]
    #[arg(long, value_name = "N")]
    copies: Option<u32>,
}

impl GatewaysArguments {
    /// What is asked.
    ///
    /// # Errors
    /// What is wrong with the arguments.
    pub fn question(self) -> Result<CompareGateways, Failure> {
        if self.copies == Some(0) {
            return Err(Failure::new(ErrorKind::Usage, "--copies 0 asks for nothing; give 1 or more, or leave it out"));
        }
        let owner = self.owner.as_deref().map(parse::value).transpose()?;
        let topic = self.topic.as_deref().map(parse::value).transpose()?;
        Ok(CompareGateways { owner, topic, copies: self.copies })
    }
}

/// The exit code: records or numbers are lacking, or not every gateway could be compared.
pub fn code(view: &GatewaysView) -> u8 {
    match view {
        GatewaysView { ok: true, .. } => 0,
        GatewaysView { short: 0, nowhere: 0, .. } => ErrorKind::Unreachable.exit_code(),
        _ => ErrorKind::Incomplete.exit_code(),
    }
}

/// All of it.
pub fn text(view: &GatewaysView) -> String {
    let row = |one: &GatewayHoldings| {
        let figures = [one.records, one.verified, one.lacking, one.waiting];
        let figure = |figure: u64| if one.problem.is_some() { "-".to_owned() } else { figure.to_string() };
        [vec![one.address.clone()], figures.map(figure).to_vec()].concat()
    };
    let rows: Vec<Vec<String>> = view.gateways.iter().map(row).collect();
    let mut lines = vec![table(&["gateway", "records", "verified", "lacking", "not verified yet"], &rows)];
    for one in &view.gateways {
        lines.extend(one.problem.iter().map(|problem| format!("{} was not compared: {problem}", one.address)));
        for untold in &one.untold {
            let whose = owner(untold.owner, untold.owner_name.as_ref());
            lines.push(format!("{} tells nothing of {whose}: {}", one.address, untold.problem));
        }
    }
    for one in view.gateways.iter().filter(|one| !one.lacks.is_empty()) {
        lines.push(format!("{} lacks:", one.address));
        lines.extend(bounded(&one.lacks, lack));
    }
    if !view.holes.is_empty() {
        lines.push("nobody that was asked has:".to_owned());
        lines.extend(bounded(&view.holes, hole));
    }
    if view.left_out > 0 {
        lines.push(format!("{} ranges are left out; ask for less with --owner and --topic", view.left_out));
    }
    lines.push(verdict(view));
    lines.join("\n")
}

fn verdict(view: &GatewaysView) -> String {
    let mut words = Vec::new();
    if view.short > 0 {
        words.push(match view.copies {
            1 => format!("{} records are at no gateway", view.short),
            copies => format!("{} records are at fewer than {copies} gateways", view.short),
        });
    }
    if view.nowhere > 0 {
        words.push(format!("{} numbers are nowhere", view.nowhere));
    }
    match (words.is_empty(), view.ok) {
        (false, _) => words.join("; "),
        (true, true) => "nothing is lacking".to_owned(),
        (true, false) => "nothing is lacking at those that were compared".to_owned(),
    }
}

fn bounded<Row>(rows: &[Row], line: fn(&Row) -> String) -> Vec<String> {
    let mut lines: Vec<String> = rows.iter().take(MOST_LINES).map(line).collect();
    if rows.len() > MOST_LINES {
        lines.push(format!("  and {} more", rows.len() - MOST_LINES));
    }
    lines
}

fn owner(owner: Address, name: Option<&String>) -> String {
    name.map_or_else(|| owner.to_string(), Clone::clone)
}

/// Numbers of a recorder on a topic: `17-204, 300`.
fn numbers(whose: String, topic: &str, recorder: RecorderId, ranges: &[(u64, u64)]) -> String {
    let recorder: String = recorder.to_string().chars().take(SHORT).collect();
    let one = |(first, last): &(u64, u64)| if first == last { first.to_string() } else { format!("{first}-{last}") };
    let mut words: Vec<String> = ranges.iter().take(MOST_RANGES).map(one).collect();
    if ranges.len() > MOST_RANGES {
        words.push(format!("and {} more", ranges.len() - MOST_RANGES));
    }
    format!("  {topic} of {whose}, recorder {recorder}: {}", words.join(", "))
}

fn lack(lack: &LackView) -> String {
    let LackView { topic, recorder, ranges, records, .. } = lack;
    let numbers = numbers(owner(lack.owner, lack.owner_name.as_ref()), topic, *recorder, ranges);
    let mut holders: Vec<&str> = lack.held_by.iter().map(String::as_str).collect();
    holders.extend(lack.here.then_some("this home"));
    let has = if holders.len() == 1 { "has" } else { "have" };
    format!("{numbers} ({records} records); {} {has} them", holders.join(", "))
}

fn hole(hole: &HoleView) -> String {
    let HoleView { topic, recorder, ranges, numbers: count, .. } = hole;
    let numbers = numbers(owner(hole.owner, hole.owner_name.as_ref()), topic, *recorder, ranges);
    format!("{numbers} ({count} numbers)")
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::model::TopicId;

    fn holdings(address: &str, lacks: Vec<LackView>) -> GatewayHoldings {
        GatewayHoldings {
            address: address.to_owned(),
            key: None,
            problem: None,
            untold: Vec::new(),
            records: 1204,
            verified: 1200,
            lacking: lacks.iter().map(|lack| lack.records).sum(),
            waiting: 4,
            lacks,
        }
    }

    fn lacking(records: u64, ranges: Vec<(u64, u64)>) -> LackView {
        LackView {
            owner: Address([7; 20]),
            owner_name: Some("alice".to_owned()),
            topic: "/odom".to_owned(),
            topic_id: TopicId([2; 16]),
            recorder: RecorderId([0x3f; 16]),
            records,
            ranges,
            held_by: vec!["a:7420".to_owned()],
            here: true,
        }
    }

    fn view(gateways: Vec<GatewayHoldings>, (short, nowhere): (u64, u64)) -> GatewaysView {
        let ok = short == 0 && nowhere == 0 && gateways.iter().all(|one| one.problem.is_none());
        GatewaysView { ok, copies: 2, short, nowhere, gateways, holes: Vec::new(), left_out: 0 }
    }

    #[test]
    fn what_is_lacking_is_told_with_its_ranges_and_ends_with_a_code_of_its_own() {
        let lacks = vec![lacking(189, vec![(17, 204), (300, 300)])];
        let lacking = view(vec![holdings("a:7420", Vec::new()), holdings("b:7420", lacks)], (189, 0));
        let told = text(&lacking);
        assert!(told.contains("b:7420 lacks:\n  /odom of alice, recorder 3f3f3f3f: 17-204, 300 (189 records); a:7420, this home have them\n"), "{told}");
        assert!(told.ends_with("189 records are at fewer than 2 gateways") && !told.contains("a:7420 lacks"), "{told}");
        let whole = view(vec![holdings("a:7420", Vec::new())], (0, 0));
        assert!(text(&whole).ends_with("nothing is lacking"));
        let away = GatewayHoldings { problem: Some("no answer".to_owned()), ..holdings("c:7420", Vec::new()) };
        let away = view(vec![holdings("a:7420", Vec::new()), away], (0, 0));
        let told = text(&away);
        assert!(
            told.contains("c:7420 was not compared: no answer\n") && told.ends_with("that were compared"),
            "{told}"
        );
        assert!(told.lines().any(|line| line.split_whitespace().eq(["c:7420", "-", "-", "-", "-"])), "{told}");
        let nowhere = GatewaysView { nowhere: 3, ok: false, ..whole.clone() };
        assert_eq!([&lacking, &whole, &away, &nowhere].map(code), [8, 0, 4, 8]);
    }

    #[test]
    fn what_a_person_is_told_is_bounded() {
        let ranges: Vec<(u64, u64)> = (1..=25).map(|number| (number * 10, number * 10 + 1)).collect();
        let lacks = (0..60).map(|_| lacking(50, ranges.clone())).collect();
        let told = text(&view(vec![holdings("b:7420", lacks)], (3000, 0)));
        assert!(told.contains("200-201, and 5 more (50 records)") && !told.contains("210-211"), "{told}");
        assert_eq!(told.lines().filter(|line| line.contains("/odom")).count(), MOST_LINES);
        assert!(told.contains("\n  and 10 more\n"), "{told}");
    }
}
