//! The rules of the sentences, by examples that another program worked out, and what is said of whole bundles.

use std::collections::{BTreeMap, BTreeSet};

use authros_model::{Address, Timestamp};
use serde_json::Value;
use strum::VariantArray as _;

use super::*;
use super::{Fact, Facts, Fields};
use crate::report::{Outcome, Reason, Standing};
use crate::tests::world::{World, ours, sealed};
use crate::{Bundle, Person, verify};

fn raw() -> Value {
    serde_json::from_str(include_str!("sentences.json")).expect("JSON")
}

#[test]
fn every_reason_and_standing_has_its_words_and_every_name_is_explained() {
    let (raw, wording) = (raw(), &*WORDING);
    let named: BTreeSet<&str> = wording.reasons.keys().map(String::as_str).collect();
    let known: BTreeSet<&str> = Reason::VARIANTS.iter().map(|reason| reason.name()).chain(["not_checked"]).collect();
    assert_eq!(named, known);
    for &standing in Standing::VARIANTS {
        let name = serde_json::to_value(standing).expect("a name");
        assert_eq!(raw["standings"][name.as_str().expect("text")], standing.word());
    }
    assert_eq!(wording.levels.keys().copied().collect::<String>(), "abcdef");
    let explained = |name: &str, list: Option<&str>| {
        let of_list = list.and_then(|list| raw["lists"][list].as_str());
        raw["facts"].get(name).is_some() || of_list.is_some_and(|text| text.contains(name))
    };
    for sentence in &wording.sentences {
        let list = sentence.each.as_deref();
        let short = sentence.short.iter().map(|text| (String::new(), text.clone()));
        for (condition, text) in sentence.say.iter().cloned().chain(short) {
            let filled = text.split(['{', '}']).skip(1).step_by(2).filter_map(|part| part.split('|').next());
            for name in condition.split_whitespace().map(|word| word.trim_start_matches('!')).chain(filled) {
                assert!(explained(name, list), "{name} in '{text}'");
            }
        }
        assert_eq!(sentence.each.is_some(), !sentence.more.is_empty(), "{sentence:?}");
    }
}

/// Names live as long as the test.
fn fields(of: &Value) -> Fields {
    let fact = |value: &Value| {
        value
            .as_str()
            .map_or_else(|| Fact::Number(value.as_u64().expect("a number")), |text| Fact::Text(text.to_owned()))
    };
    let all = of.as_object().expect("named values");
    all.iter().map(|(name, value)| (&*Box::leak(name.clone().into_boxed_str()), fact(value))).collect()
}

#[test]
fn the_lines_are_those_that_another_program_makes_by_the_same_rules() {
    let examples: Vec<Value> = serde_json::from_str(include_str!("examples.json")).expect("JSON");
    for example in &examples {
        let lists = example["lists"].as_object().expect("lists").iter().map(|(name, items)| {
            let name: &'static str = Box::leak(name.clone().into_boxed_str());
            (name, items.as_array().expect("items").iter().map(fields).collect())
        });
        let facts = Facts { all: fields(&example["facts"]), lists: lists.collect() };
        let told = sentences(&WORDING, &facts);
        let lines: Vec<String> = told.iter().flat_map(|one| wrapped(one, WORDING.width)).collect();
        assert_eq!(Value::from(lines.clone()), example["lines"], "{}", example["what"]);
        assert!(lines.len() <= WORDING.lines, "{}: {} lines", example["what"], lines.len());
        assert!(lines.iter().all(|line| line.chars().count() <= WORDING.width), "{}", example["what"]);
    }
    assert!(examples.len() > 4);
}

/// The longest of everything: of the flags only these, so many items in each list, and this for every name.
fn longest(flags: [&str; 2], items: usize, name: &str) -> Facts {
    const ONE_OF: [&str; 7] = [
        "holds",
        "refused",
        "self_sealed",
        "unknown_exporter",
        "exporter_proven",
        "exporter_self_sealed",
        "exporter_refused",
    ];
    let text = |text: &str| Fact::Text(text.to_owned());
    let levels = |standing: &str| {
        let level = |(letter, name): (&char, &String)| format!("({letter}) {name}: {standing}");
        text(&WORDING.levels.iter().map(level).collect::<Vec<_>>().join("; "))
    };
    let every: Vec<String> =
        Standing::VARIANTS.iter().map(|standing| format!("1,000,000 {}", standing.word())).collect();
    let every = every.join(", ");
    let raw = raw();
    let mut all: Fields = fields(&raw["facts"]).into_keys().map(|name| (name, Fact::Number(1_000_000))).collect();
    all.extend(ONE_OF.map(|flag| (flag, Fact::Number(u64::from(flags.contains(&flag))))));
    all.extend([
        ("exporter", text(&Address([0xab; 20]).to_string())),
        ("exporter_person", text(name)),
        ("captured", text("2026-11-26 22:08:00 to 2026-11-27 22:10:59 UTC")),
        ("levels", levels(&every)),
        ("worst", levels(Standing::OwnChain.word())),
    ]);
    let item = Fields::from([
        ("topic", text(name)),
        ("person", text(name)),
        ("authority", text(name)),
        ("why", text(&"why ".repeat(20))),
        ("count", Fact::Number(u64::MAX)),
        ("proven", Fact::Number(1)),
    ]);
    let lists = fields(&raw["lists"]).into_keys().map(|list| (list, vec![item.clone(); items])).collect();
    Facts { all, lists }
}

#[test]
fn no_name_makes_a_verdict_longer_than_its_lines() {
    let names = ["n".repeat(40), "n ".repeat(20), "nnnnnnnnn ".repeat(4), format!("{} {0}n", "n".repeat(19))];
    for outcome in ["holds", "refused", "self_sealed", "unknown_exporter", "none"] {
        for exporter in ["exporter_proven", "exporter_self_sealed", "exporter_refused", "none"] {
            for (items, name) in [0, 1, 4, 9].into_iter().flat_map(|items| names.iter().map(move |name| (items, name)))
            {
                let said = sentences(&WORDING, &longest([outcome, exporter], items, name));
                let lines: Vec<String> = said.iter().flat_map(|one| wrapped(one, WORDING.width)).collect();
                assert!(lines.len() <= WORDING.lines, "{outcome}, {exporter}, {items}, {name}: {lines:#?}");
            }
        }
    }
}

#[test]
fn a_bundle_that_holds_says_by_whom_when_and_what_is_readable() {
    let mut world = World::new();
    let secret = authros_crypto::record::RecordSecret::of(&world.topic_key, &world.record.header);
    world.disclose(&world.keys.clone(), secret);
    let mut trust = World::trust();
    trust.persons.push(Person { account: world.owner, name: "the harbour".to_owned(), key: None });
    let report = world.report_by(&trust);
    let owner = world.owner;
    assert_eq!(report.outcome, Outcome::Holds);
    let expected = [
        "HOLDS: what such a file has to prove is proven by what you pinned.".to_owned(),
        "The file has 1 record.".to_owned(),
        "All records are unaltered since they were signed.".to_owned(),
        format!("Signed by the harbour ({owner}): 1 record."),
        format!("Put together by the harbour ({owner})."),
        "1 record existed no later than 2023-11-14 22:15:00 UTC, by the clock of the block signers that you pinned."
            .to_owned(),
        "Captured 2023-11-14 22:14:53 UTC, as their owner claims.".to_owned(),
        "Readable: 1 record of /robot1/odom, 2023-11-14 22:14:53 UTC.".to_owned(),
        "Sealed: nothing.".to_owned(),
        "Not stated: the last number of 1 topic; later records may exist.".to_owned(),
    ];
    assert_eq!(report.verdict[..expected.len()], expected);
    let last = report.verdict.last().expect("the levels");
    assert_eq!(
        last,
        "Levels: (a) bytes: proven; (b) signer: proven; (c) anchor: proven; (d) outside time: absent; (e) disclosure: \
         proven; (f) numbers: proven."
    );
    let lines = report.lines();
    assert!(lines.len() <= 25 && lines.iter().all(|line| line.chars().count() <= 80), "{lines:#?}");
}

#[test]
fn what_is_not_proven_is_said_once_for_a_topic_and_a_reason() {
    let world = World::new();
    let mut packing = world.packing();
    for seq in 10..60 {
        let one = sealed(world.owner, &world.keys, &world.topic_key, seq, b"more");
        packing.record(one.digest, crate::tests::hostile::unanchored(one)).expect("added");
    }
    let members = packing.sign(crate::tests::world::genesis(), world.owner, &world.keys, ours()).expect("packs");
    let bundle = Bundle::of_members(&members, ours()).expect("reads");
    let report = verify(&bundle, Some(&World::trust()), ours());
    let doubts: Vec<&String> = report.verdict.iter().filter(|one| one.starts_with("Not proven: 50")).collect();
    let expected = "Not proven: 50 records of a topic with a sealed name (08080808), 2023-11-14 22:14:53 UTC: it was on no \
                    chain when the file was made.";
    assert_eq!(doubts, [expected]);
    assert!(report.verdict.iter().any(|one| one == "No time is shown for 50 records."), "{:#?}", report.verdict);
    let nobody = verify(&bundle, None, ours());
    let expected = "Not proven: 1 record of a topic with a sealed name (08080808), 2023-11-14 22:14:53 UTC: you gave no trust \
                    file, so the seals on its block prove nothing.";
    assert!(nobody.verdict.iter().any(|one| one == expected), "{:#?}", nobody.verdict);
    assert!(nobody.verdict[0].contains("you gave no trust file"), "{:#?}", nobody.verdict);
}

#[test]
fn a_refused_record_is_named_first_and_only_by_its_own_cause() {
    let world = World::new();
    let mut members = world.members();
    let place = members.keys().find(|name| name.ends_with("record.bin")).expect("a record").clone();
    *members.get_mut(&place).expect("there").last_mut().expect("bytes") ^= 1;
    let members = crate::Packing::from(members).sign(crate::tests::world::genesis(), world.owner, &world.keys, ours());
    let bundle = Bundle::of_members(&members.expect("packs"), ours()).expect("reads");
    let report = verify(&bundle, Some(&World::trust()), ours());
    assert!(report.verdict[0].starts_with("REFUSED: "), "{:#?}", report.verdict);
    let causes: Vec<&String> = report.verdict.iter().filter(|one| one.contains(" of unreadable data")).collect();
    assert_eq!(causes, ["REFUSED: 1 record of unreadable data: it is not the record that it is filed as."]);
    assert!(report.verdict.contains(&"0 records are unaltered since signing, 1 record is NOT.".to_owned()));
}

#[test]
fn numbers_times_and_spans_are_short() {
    for (number, text) in [(0, "0"), (999, "999"), (1_000, "1,000"), (1_234_567, "1,234,567")] {
        assert_eq!(grouped(number), text);
    }
    let at = |second: u64| Timestamp(1_700_000_000_500_000_000 + second * 1_000_000_000);
    assert_eq!(super::span(at(0), at(0)), "2023-11-14 22:13:20 UTC");
    assert_eq!(super::span(at(0), at(100)), "2023-11-14 22:13:20 to 22:15:00 UTC");
    assert_eq!(super::span(at(0), at(86_400)), "2023-11-14 22:13:20 to 2023-11-15 22:13:20 UTC");
    assert_eq!(wrapped("one two three", 8), ["one two", "  three"]);
    let fields: Fields = BTreeMap::from([("n", Fact::Number(1)), ("name", Fact::Text("{n} </b>".to_owned()))]);
    assert_eq!(
        filled("{n|record|records} of {name}", &[&fields]),
        "1 record of {n} </b>",
        "a name is not filled again"
    );
    assert!(holds("n !m", &[&fields]) && !holds("m", &[&fields]) && holds("", &[&fields]));
}
