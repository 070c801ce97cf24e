use super::*;
use proptest::prelude::*;

/// Berlin's rules: +01:00, and +02:00 from the last Sunday of March to that of October.
const BERLIN: &str = "CET-1CEST,M3.5.0,M10.5.0/3";
/// By `tests/peers/typed_times.py`.
const EXPECTED: &str = include_str!("expected.tsv");

fn zone(text: &str) -> Zone {
    Zone::new(TimeZone::posix(text).expect(text))
}

fn clock(now: &str, place: &str) -> Clock {
    let now = OffsetDateTime::parse(now, &Rfc3339).expect(now).unix_timestamp_nanos();
    Clock { now: Timestamp(u64::try_from(now).expect("after 1970")), zone: zone(place) }
}

#[test]
fn times_are_read_as_pythons_datetime_reads_them() {
    let mut read = 0;
    for line in EXPECTED.lines() {
        let [place, now, direction, text, expected] = parts(line, '\t').expect(line);
        let now = Timestamp(number::<u64>(now).expect(now) * 1_000_000);
        let direction = if direction == "back" { Direction::Back } else { Direction::Ahead };
        let found = match (Clock { now, zone: zone(place) }).read(text, direction) {
            Ok(moment) => {
                assert_eq!(moment.0 % 1_000_000, 0, "{line}");
                (moment.0 / 1_000_000).to_string()
            }
            Err(MomentError::Skipped(_)) => "skipped".to_owned(),
            Err(MomentError::Twice(_)) => "twice".to_owned(),
            Err(error) => panic!("{line}: {error}"),
        };
        assert_eq!(found, expected, "{line}");
        read += 1;
    }
    assert_eq!(read, 500);
}

#[test]
fn each_form_has_one_meaning() {
    // Berlin: 2026-11-26 22:56:20.500, a Thursday.
    let clock = clock("2026-11-26T21:56:20.5Z", BERLIN);
    for (text, back, ahead) in [
        ("now", "2026-11-26T21:56:20.5Z", "2026-11-26T21:56:20.5Z"),
        ("10m", "2026-11-26T21:46:20.5Z", "2026-11-26T22:06:20.5Z"),
        ("-10m", "2026-11-26T21:46:20.5Z", "2026-11-26T21:46:20.5Z"),
        ("+10m", "2026-11-26T22:06:20.5Z", "2026-11-26T22:06:20.5Z"),
        ("18:00", "2026-11-26T17:00:00Z", "2026-11-27T17:00:00Z"),
        ("23:00", "2026-11-25T22:00:00Z", "2026-11-26T22:00:00Z"),
        ("18:00Z", "2026-11-26T18:00:00Z", "2026-11-27T18:00:00Z"),
        ("18:00 UTC", "2026-11-26T18:00:00Z", "2026-11-27T18:00:00Z"),
        ("tomorrow 18:00", "2026-11-27T17:00:00Z", "2026-11-27T17:00:00Z"),
        ("tomorrow", "2026-11-26T23:00:00Z", "2026-11-26T23:00:00Z"),
        ("today", "2026-11-25T23:00:00Z", "2026-11-25T23:00:00Z"),
        ("friday 18:00", "2026-11-20T17:00:00Z", "2026-11-27T17:00:00Z"),
        ("thu 22:00", "2026-11-26T21:00:00Z", "2026-12-03T21:00:00Z"),
        ("2026-11-27 18:00", "2026-11-27T17:00:00Z", "2026-11-27T17:00:00Z"),
        ("2026-11-27T18:00:00.125", "2026-11-27T17:00:00.125Z", "2026-11-27T17:00:00.125Z"),
        ("2026-11-27", "2026-11-26T23:00:00Z", "2026-11-26T23:00:00Z"),
        ("2026-11-27Z", "2026-11-27T00:00:00Z", "2026-11-27T00:00:00Z"),
        ("2026-07-01 18:00", "2026-07-01T16:00:00Z", "2026-07-01T16:00:00Z"),
        ("2026-11-27T18:00:00-05:00", "2026-11-27T23:00:00Z", "2026-11-27T23:00:00Z"),
    ] {
        for (direction, expected) in [(Direction::Back, back), (Direction::Ahead, ahead)] {
            let found = clock.read(text, direction).map(|moment| moment.to_string());
            assert_eq!(found.as_deref(), Ok(expected), "{text} {direction:?}");
        }
    }
}

#[test]
fn anything_else_says_how_to_write_it() {
    let clock = clock("2026-11-26T21:56:20Z", BERLIN);
    let bad = "|soon|18|1800|24:00|18:60|18:00:60|8:0|18:00.5|18:00:00.|18:00:00.1234567890|0s|--1m|1m ago|2026-13-01|\
               2026-02-29|2026-1-1|26-11-27|2026-11-2718:00|18:00 tomorrow|18:00 CET|18:00+1|utc|1969-12-31|fri sat|\
               9999-12-31|+18:00|é|18:00 18:00|2026-11-27 18:00 UTC UTC";
    for text in bad.split('|').map(str::trim) {
        let error = clock.back(text).expect_err(text);
        assert!(error.to_string().contains("yesterday 18:00"), "{text}: {error}");
    }
    assert!(!clock.end("1\u{1b}[2J").expect_err("control").to_string().contains('\u{1b}'));
}

#[test]
fn what_clocks_skip_or_show_twice_is_refused() {
    let clock = clock("2026-03-28T12:00:00Z", BERLIN);
    assert!(matches!(clock.end("tomorrow 02:30"), Err(MomentError::Skipped(_))));
    assert!(matches!(clock.end("2026-10-25 02:30"), Err(MomentError::Twice(_))));
    let either = ["2026-10-25T02:30:00+02:00", "2026-10-25 02:30+01:00"].map(|text| clock.end(text).ok());
    assert_eq!(either, [1_792_888_200, 1_792_891_800].map(|seconds| Some(Timestamp::from_seconds(seconds))));
}

#[test]
fn an_end_is_a_whole_second_to_come() {
    let clock = clock("2026-11-26T21:56:20.5Z", BERLIN);
    let end = |text: &str| clock.end(text).map(|moment| moment.to_string());
    assert_eq!(end("30d").as_deref(), Ok("2026-12-26T21:56:21Z"));
    assert_eq!(end("2030-01-31T12:00:00.5Z").as_deref(), Ok("2030-01-31T12:00:01Z"));
    for past in ["-1h", "yesterday 18:00", "2026-11-26", "2026-11-26T21:56:20Z"] {
        assert!(matches!(clock.end(past), Err(MomentError::Passed(_))), "{past}");
    }
    let midnight = clock.end("2026-11-26").expect_err("today's midnight").to_string();
    assert!(midnight.contains("2026-11-26 00:00:00 local = 2026-11-25 23:00:00 UTC has passed"), "{midnight}");
}

#[test]
fn times_of_a_sentence_get_the_readers_beside_them() {
    let berlin = clock("2026-11-26T21:56:20Z", BERLIN);
    let [since, ends] = [1_700_000_000, 1_700_003_600].map(Timestamp::from_seconds);
    let text = format!("opened since {}, ends {}", since.in_utc(), ends.in_utc());
    let expected = "opened since 2023-11-14 23:13:20 local = 2023-11-14 22:13:20 UTC, \
                    ends 2023-11-15 00:13:20 local = 2023-11-14 23:13:20 UTC";
    assert_eq!(berlin.explained(&text, &[since, ends]), expected);
    assert_eq!(Clock::default().explained(&text, &[since, ends]), text);
}

#[test]
fn a_meaning_is_local_and_utc() {
    let clock = clock("2026-11-26T21:56:20Z", BERLIN);
    let meaning = |text: &str| clock.back(text).map(|moment| clock.meaning(moment));
    let both = "2026-11-27 00:30:00.250 local = 2026-11-26 23:30:00.250 UTC";
    assert_eq!(meaning("2026-11-26T23:30:00.25Z").as_deref(), Ok(both));
    let here = Clock { zone: Zone::default(), ..clock.clone() };
    assert_eq!(here.meaning(Timestamp::from_seconds(1_700_000_000)), "2023-11-14 22:13:20 UTC");
    assert_eq!(Zone::default().clock(Timestamp(0)), None);
    assert_eq!(zone("CST-8").clock(Timestamp::from_seconds(1_700_000_000)).as_deref(), Some("06:13:20"));
}

proptest! {
    /// The offset by hand: no calendar is involved.
    #[test]
    fn what_a_meaning_says_is_read_as_that_moment(now in 0_u64..4_000_000_000_000, at in 0_u64..4_000_000_000_000, minutes in -720_i32..=720) {
        let zone = Zone::new(TimeZone::fixed(Offset::from_seconds(minutes * 60).expect("an offset")));
        let clock = Clock { now: Timestamp(now * 1_000_000), zone };
        let at = Timestamp(at * 1_000_000);
        let meaning = clock.meaning(at);
        for text in meaning.split(" = ").map(|part| part.trim_end_matches(" local")) {
            prop_assert_eq!(clock.back(text), Ok(at), "{}", text);
        }
        let utc = meaning.rsplit(" = ").next().unwrap_or_default();
        let day = at.seconds() % 86_400;
        let clock_of_utc = format!(" {:02}:{:02}:{:02}", day / 3600, day / 60 % 60, day % 60);
        prop_assert!(utc.contains(&clock_of_utc), "{}", utc);
    }

    #[test]
    fn a_bare_clock_is_within_a_day(now in 1_000_000_000_u64..4_000_000_000, second in 0_u64..86_400, minutes in -720_i32..=720) {
        let zone = Zone::new(TimeZone::fixed(Offset::from_seconds(minutes * 60).expect("an offset")));
        let clock = Clock { now: Timestamp::from_seconds(now), zone };
        let text = format!("{:02}:{:02}:{:02}", second / 3600, second / 60 % 60, second % 60);
        let (back, ahead) = (clock.back(&text).expect("the last"), clock.end(&text).expect("the next"));
        prop_assert_eq!(ahead.seconds() - back.seconds(), 86_400);
        prop_assert!(back <= clock.now && clock.now < ahead);
        let local = i64::try_from(back.seconds()).expect("small") + i64::from(minutes) * 60;
        prop_assert_eq!(local.rem_euclid(86_400), i64::try_from(second).expect("small"));
    }

    #[test]
    fn no_text_panics_and_each_error_is_shown_clean(text in "\\PC{0,60}", ahead: bool) {
        let clock = Clock { now: Timestamp::from_seconds(1_795_730_180), zone: zone(BERLIN) };
        let read = clock.read(&text, if ahead { Direction::Ahead } else { Direction::Back });
        prop_assert!(read.err().is_none_or(|error| error.to_string().chars().all(|letter| !letter.is_control())));
    }

    #[test]
    fn texts_close_to_times_never_panic(text in "(today|fri|2026-1[0-9]-[0-3][0-9]|[+-])?[ tT]?[0-9]{1,2}:[0-9]{1,2}(:[0-9]{2})?(\\.[0-9]{0,10})?(z|Z| UTC|[+-][0-9]{2}:[0-9]{2})?") {
        let clock = Clock { now: Timestamp::from_seconds(1_795_730_180), zone: zone(BERLIN) };
        drop((clock.back(&text), clock.end(&text)));
    }
}
