//! Nothing is off unnoticed: the passphrase is asked for at the start, and each topic shows its state.

use super::{Robot, fixtures};
use crate::app::available::available;
use crate::app::identity_path;
use crate::app::{Action, Feed, Key, Need, Popup, Purpose, Settings, Tag, Verb};
use crate::model::{Address, Timestamp};
use crate::screens::topics::capture::Capture;
use crate::service::reply::{
    AlertView, EndedAlert, GrantRow, HealthLevel, HeldUp, IdentityView, LifeLine, PartHealth, SiteView, TopicRow,
};
use crate::service::{Command, Event, NoticeLevel, Part, Reply};

/// A console that has just been opened on a profile, locked or not.
fn opened(unlocked: bool, asks_passphrase: bool) -> Robot {
    let mut robot = Robot::opens(Settings { asks_passphrase, ..Settings::default() });
    robot.is_answered(&Tag::Feed(Feed::Identity, 0), Ok(Reply::Identity(fixtures::identity(true, unlocked, true))));
    robot
}

fn is_asked(robot: &Robot) -> bool {
    matches!(robot.state.popups.last(), Some(Popup::Form(Purpose::Unlock, _)))
}

#[test]
fn a_locked_profile_asks_for_its_passphrase_at_once_and_esc_looks_around() {
    let mut robot = opened(false, true);
    assert!(is_asked(&robot));
    robot.types("correct horse");
    robot.presses(Key::Enter);
    assert!(matches!(robot.sent.last(), Some((Command::Unlock { .. }, Tag::Unlock))));

    let mut robot = opened(false, true);
    robot.presses(Key::Escape);
    assert!(robot.state.popups.is_empty() && robot.state.is_locked());
    robot.hears_of(Part::Identity);
    robot.is_answered(&Tag::Feed(Feed::Identity, 0), Ok(Reply::Identity(fixtures::identity(true, false, true))));
    assert!(robot.state.popups.is_empty(), "it asks once");
}

#[test]
fn who_is_asked_for_a_stored_passphrase_is_told_where_it_is() {
    let place = "/home/operator/.local/share/authros/profiles/default/passphrase";
    for stored in [Some(place.to_owned()), None] {
        let mut robot = Robot::opens(Settings::default());
        let identity = IdentityView { passphrase_file: stored.clone(), ..fixtures::identity(true, false, true) };
        robot.is_answered(&Tag::Feed(Feed::Identity, 0), Ok(Reply::Identity(identity)));
        robot.types("u");
        let Some(Popup::Form(Purpose::Unlock, form)) = robot.state.popups.last() else { panic!("no form") };
        assert_eq!(form.notes.iter().any(|note| note.contains(place)), stored.is_some(), "{:?}", form.notes);
    }
}

#[test]
fn an_operator_is_never_asked_for_a_passphrase() {
    let mut robot = Robot::opens(Settings { operator: Some("bob".to_owned()), ..Settings::default() });
    robot.is_answered(&Tag::Feed(Feed::Identity, 0), Ok(Reply::Identity(fixtures::identity(true, false, true))));
    for verb in [Verb::Unlock, Verb::CreateIdentity, Verb::LoadKey, Verb::ExportKey] {
        assert_eq!(available(&robot.state, verb), Err("only for the owner"));
    }
    robot.types("u");
    identity_path::run(&mut robot.state, Need::Unlocked, Vec::new());
    assert!(robot.state.popups.is_empty() && robot.state.identity_path.is_none());
    assert!(robot.sent.iter().all(|(command, _)| !matches!(command, Command::Unlock { .. })));
}

#[test]
fn the_seconds_until_the_next_attempt_are_counted_down_and_the_last_one_stays() {
    let mut robot = Robot::at_work(true);
    robot.hears_of(Part::Health);
    let mut site = fixtures::site();
    let chain = site.health.iter_mut().find(|part| part.part == "chain").expect("a chain");
    (chain.level, chain.retry) = (HealthLevel::Failed, Some(4));
    chain.text = "retry in 4 s: http://127.0.0.1:8545 does not answer".to_owned();
    robot.is_answered(&Tag::Feed(Feed::Site, 0), Ok(Reply::Site(site)));
    let said = |robot: &Robot| robot.state.site.as_ref().expect("known").health[1].text.clone();
    let mut seen = Vec::new();
    while let Some(at) = crate::app::when::moves_at(&robot.state) {
        assert_eq!(at, Timestamp(robot.state.now.0 + 1_000_000_000));
        robot.waits(1);
        seen.push(said(&robot));
    }
    let left = |seconds| format!("retry in {seconds} s: http://127.0.0.1:8545 does not answer");
    assert_eq!(seen, [left(3), left(2), left(1)]);
    robot.waits(30);
    assert_eq!(said(&robot), left(1), "until the site says what came of it");
}

#[test]
fn a_frozen_view_counts_nothing_down() {
    let mut robot = Robot::at_work(true);
    robot.hears_of(Part::Health);
    let mut site = fixtures::site();
    (site.health[1].retry, site.health[1].text) = (Some(4), "retry in 4 s: it is away".to_owned());
    robot.is_answered(&Tag::Feed(Feed::Site, 0), Ok(Reply::Site(site)));
    robot.types("f");
    robot.waits(2);
    assert_eq!(crate::app::when::moves_at(&robot.state), None);
    assert_eq!(robot.state.site.as_ref().expect("known").health[1].text, "retry in 4 s: it is away");
}

#[test]
fn it_does_not_ask_where_the_keyring_is_open_or_opens_in_another_way_or_somebody_is_typing() {
    assert!(!is_asked(&opened(true, true)));
    assert!(!is_asked(&opened(false, false)));
    let mut typing = Robot::opens(Settings { asks_passphrase: true, ..Settings::default() });
    typing.types("2");
    typing.is_answered(&Tag::Feed(Feed::Identity, 0), Ok(Reply::Identity(fixtures::identity(true, false, true))));
    assert!(!is_asked(&typing), "no key that was meant for a screen goes into a passphrase");
}

#[test]
fn a_passphrase_for_an_open_keyring_is_not_taken_for_commands() {
    let mut robot = opened(true, true);
    robot.site_answers(true);
    robot.types("ucorrect horse 4q");
    assert!(matches!(robot.state.popups.last(), Some(Popup::Unlocked)));
    assert_eq!((robot.state.screen, robot.work().len()), (crate::app::Screen::Overview, 0));
    robot.presses(Key::Enter);
    assert!(robot.state.popups.is_empty());
}

#[test]
fn a_question_for_a_passphrase_goes_when_the_keyring_was_opened_elsewhere() {
    let mut robot = opened(false, true);
    robot.hears_of(Part::Identity);
    robot.is_answered(&Tag::Feed(Feed::Identity, 0), Ok(Reply::Identity(fixtures::identity(true, true, true))));
    assert!(robot.state.popups.is_empty());
}

#[test]
fn each_topic_says_how_its_capture_stands_and_the_worst_is_said_first() {
    let row = TopicRow { watched: true, ..fixtures::topic("/robot1/odom", 20.0) };
    let waits = TopicRow { held_up: Some(HeldUp::WaitsForKey), publishers: Vec::new(), ..row.clone() };
    let paused = TopicRow { held_up: Some(HeldUp::Paused), ..row.clone() };
    let silent = TopicRow { publishers: Vec::new(), ..row.clone() };
    let words = [&row, &waits, &paused, &silent].map(|row| Capture::of(row).word());
    assert_eq!(words, ["watched", "waits for key", "paused", "no publisher"]);
    assert_eq!(Capture::of(&TopicRow { watched: false, ..row }).word(), "-");

    let mut robot = opened(false, false);
    robot.site_answers(true);
    robot.state.identity = Some(fixtures::identity(true, false, true));
    robot.state.topics.rows = vec![waits, paused];
    robot.waits(1);
    let alert =
        robot.state.alerts.shown().into_iter().map(|alert| alert.text.clone()).find(|text| text.starts_with("locked"));
    assert_eq!(alert.as_deref(), Some("locked: capture of 1 topic waits for the key; u unlocks"));
}

/// The site reports its state.
fn says(robot: &mut Robot, site: SiteView) {
    robot.hears_of(Part::Health);
    robot.is_answered(&Tag::Feed(Feed::Site, 0), Ok(Reply::Site(site)));
}

/// Of each alert shown: its text, since when, and when it ended.
fn alerts(robot: &Robot) -> Vec<(String, u64, Option<u64>)> {
    let shown = robot.state.alerts.shown().into_iter();
    shown.map(|alert| (alert.text.clone(), alert.since.seconds(), alert.resolved.map(|at| at.seconds()))).collect()
}

#[test]
fn what_the_site_judges_is_shown_since_its_own_moment_and_then_as_over() {
    let mut robot = Robot::at_work(true);
    let alert = fixtures::site_alert();
    let (text, begun) = (alert.text.clone(), fixtures::NOW.seconds() - 60);
    says(&mut robot, SiteView { alerts: vec![alert.clone()], ..fixtures::site() });
    assert_eq!(alerts(&robot), [(text.clone(), begun, None)], "this console was not there when it began");
    let ended = EndedAlert { alert: alert.clone(), ended: Timestamp::from_seconds(fixtures::NOW.seconds() + 5) };
    robot.waits(9);
    says(&mut robot, SiteView { alerts_over: vec![ended.clone()], ..fixtures::site() });
    assert_eq!(alerts(&robot), [(text.clone(), begun, Some(fixtures::NOW.seconds() + 5))]);

    let mut later = Robot::at_work(true);
    later.waits(60);
    says(&mut later, SiteView { alerts_over: vec![ended], ..fixtures::site() });
    assert_eq!(alerts(&later), [(text, begun, Some(fixtures::NOW.seconds() + 5))], "over before it was opened");
}

fn failing(part: &str, text: &str) -> SiteView {
    let mut site = fixtures::site();
    let found = site.health.iter_mut().find(|other| other.part == part).expect("a part");
    (found.level, found.text) = (HealthLevel::Failed, text.to_owned());
    site
}

#[test]
fn a_message_goes_when_its_part_is_well_again() {
    let mut robot = Robot::at_work(true);
    let notice = |about: &str, text: &str| {
        let (text, about) = (text.to_owned(), Some(about.to_owned()));
        Action::Told(Event::Notice { at: fixtures::NOW, level: NoticeLevel::Error, text, about })
    };
    robot.act(notice("ros", "the master is away"));
    robot.act(notice("alert disk", "the disk is full"));
    says(&mut robot, failing("ros", "the master is away"));
    assert_eq!(robot.state.toasts.unseen(), 2);
    says(&mut robot, fixtures::site());
    assert_eq!((robot.state.toasts.unseen(), robot.message()), (1, "the disk is full"));
}

#[test]
fn a_chain_that_is_away_is_one_alert_and_enter_shows_all_of_it() {
    let mut robot = Robot::at_work(true);
    robot.types("1");
    assert!(available(&robot.state, Verb::Alerts).is_err(), "nothing to show yet");
    // Without the chain nobody knows whether the profile is registered.
    robot.state.identity = Some(fixtures::identity(true, true, false));
    let text = "start the pinned chain, or `authros --home NEW records import OLD`: the chain is another one";
    let caused = |key: &str| AlertView { key: key.to_owned(), text: key.to_owned(), ..fixtures::site_alert() };
    let alerts_of = ["chain", "unanchored/0a0b0c0d", "audit"].map(caused).into();
    says(&mut robot, SiteView { alerts: alerts_of, ..failing("chain", text) });
    let texts: Vec<String> = alerts(&robot).into_iter().map(|(text, ..)| text).collect();
    assert_eq!(texts, [format!("chain: {text}")]);
    robot.presses(Key::Enter);
    assert!(matches!(robot.state.popups.last(), Some(Popup::Alerts(0))));
    robot.presses(Key::Enter);
    assert!(robot.state.popups.is_empty());
}

#[test]
fn an_accounts_paused_lane_hides_no_alert_of_another_account() {
    let mut robot = Robot::at_work(true);
    let mut site = failing("chain", "anchoring for 0x0101… is paused");
    let chain = site.health.iter_mut().find(|part| part.part == "chain").expect("a part");
    chain.unaffected = vec![Address([9; 20])];
    let alert = |key: &str| AlertView { key: key.to_owned(), text: key.to_owned(), ..fixtures::site_alert() };
    site.alerts = ["unanchored/01010101", "unanchored/09090909", "audit"].map(alert).into();
    says(&mut robot, site);
    let texts: Vec<String> = alerts(&robot).into_iter().map(|(text, ..)| text).collect();
    let is_shown = |key: &str| texts.iter().any(|text| text == key);
    assert!(!is_shown("unanchored/01010101"), "the chain's alert says it: {texts:?}");
    assert!(is_shown("unanchored/09090909") && is_shown("audit"), "{texts:?}");
}

#[test]
fn the_site_decides_when_the_end_of_a_grant_is_near_and_the_console_names_the_reader() {
    let mut robot = Robot::at_work(true);
    let ends = Timestamp(fixtures::NOW.0 + 2 * 3_600 * 1_000_000_000);
    let grant = fixtures::grant("given", fixtures::OTHER, "active", 1);
    robot.state.grants.rows = vec![GrantRow { expires: Some(ends), name: Some("bob".to_owned()), ..grant.clone() }];
    says(&mut robot, fixtures::site());
    assert!(alerts(&robot).is_empty(), "{:?}", alerts(&robot));
    let short = |account: Address| account.to_string().trim_start_matches("0x")[..8].to_lowercase();
    let key = format!("grant_ends/{}-{}", short(grant.owner), short(grant.grantee));
    says(&mut robot, SiteView { alerts: vec![AlertView { key, ..fixtures::site_alert() }], ..fixtures::site() });
    let texts: Vec<String> = alerts(&robot).into_iter().map(|(text, ..)| text).collect();
    let [text] = texts.as_slice() else { panic!("one alert: {texts:?}") };
    assert!(text.contains("the grant to bob ends in 2 h"), "{text}");
}

#[test]
fn what_health_and_life_line_say_is_not_said_twice() {
    let mut robot = Robot::at_work(true);
    let own = fixtures::OWN.to_string().trim_start_matches("0x").to_lowercase();
    let keys = ["chain", "clock", "gap", &format!("tampered/{}", &own[..8]), "tampered/12345678"].map(str::to_owned);
    let alert = |key: String| AlertView { text: key.clone(), key, ..fixtures::site_alert() };
    let life = LifeLine { tampered: 1, lost_in_transport: 3, ..fixtures::site().life };
    let mut site = SiteView { life, alerts: keys.map(alert).into(), ..fixtures::site() };
    site.health[1].level = HealthLevel::Failed;
    let clock = PartHealth { part: "clock".to_owned(), level: HealthLevel::Waiting, ..site.health[0].clone() };
    site.health.push(clock);
    says(&mut robot, site);
    let texts: Vec<String> = alerts(&robot).into_iter().map(|(text, ..)| text).collect();
    assert_eq!(texts.iter().filter(|text| text.starts_with("chain")).count(), 1, "{texts:?}");
    assert_eq!(
        texts.iter().filter(|text| text.contains("tampered")).count(),
        2,
        "own and another account's: {texts:?}"
    );
    assert!(texts.iter().all(|text| text != "gap" && text != "clock"), "{texts:?}");
}
