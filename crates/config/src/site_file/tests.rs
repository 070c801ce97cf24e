//! A site file holds everything that defines a site, survives a round trip, and refuses what does not belong in it.

use super::*;

const BOB: &str = "0x5aAeb6053F3E94C9b9A09f33669435E7Ef1BeAed";
const PRINT: &str = "0011 2233 4455 6677 8899 aabb ccdd eeff";

fn read(text: &str) -> Result<SiteFile, ConfigError> {
    SiteFile::read(Path::new("site.toml"), text)
}

fn home(text: &str) -> HomeSettings {
    HomeSettings::read(Path::new("config.toml"), text).expect(text)
}

/// A value other than the default for every setting; those that exclude each other are in two groups.
fn examples() -> Vec<(&'static str, String)> {
    let folder = std::env::temp_dir();
    let secret = folder.join(format!("authros-site-file-{}", std::process::id()));
    if !secret.exists() {
        crate::crypto::private_file::create_private(&secret, b"0123456789abcdef").expect("a secret");
    }
    let of = |name: &str| {
        match name {
            "ros.master" => "http://robot:11311",
            "ros.meter" => "watched",
            "ros.pins" => "list",
            "ros.publishers" => "/a=/driver@h:std_msgs/String:992ce8a1687cec8c8bd883ec73ca41d1",
            "robots" => "2",
            "chain.url" => "http://node:8545",
            "chain.contract" => BOB,
            "chain.max_fee" => "20",
            "chain.consensus" => "pow:4",
            "capture.memory" => "64MiB",
            "vault.url" => "redis://h:6379",
            "vault.backlog" => "1GiB",
            "vault.local" => "12h",
            "outbox.keep" => "always",
            "resend.after" | "fleet.away_after" => "30s",
            "fleet.copies" => "2",
            "ring.keep" => "5m, 500MiB",
            "ring.topics" => "[\"/camera/**\", \"/imu\"]",
            "retention" => "/tf=1h, **=90d+10GiB",
            "disk.reserve" => "128MiB",
            "record.compression" => "off",
            "crypto.provider" => "libsm",
            "anchor.mode" => "each",
            "anchor.lanes" => "2",
            "audit.anchor_every" => "30",
            "audit.scrub" => "3",
            "metrics.listen" => "0.0.0.0:9464",
            "metrics.open" | "metrics.topics" | "console.ascii" | "console.mouse" | "site.trust_first" => "yes",
            "operators.socket" => "/run/authros/operators.sock",
            "operators.rights" => "{ bob = [\"look\"] }",
            "alerts.webhook" => "http://h:1/api/v2/alerts",
            "alerts.form" => "alertmanager",
            "alerts.secret" | "alerts.roots" => return secret.display().to_string(),
            "alerts.command" => "[\"/bin/page\", \"a b\"]",
            "alerts.every" | "console.lock_after" => "7",
            "alerts.robot_silent" | "alerts.unanchored" | "alerts.clock" | "alerts.grant_ends" | "alerts.audit" => {
                "never"
            }
            "alerts.disk" => "2GiB",
            "ros.domain" => "7",
            "ros.publisher" | "ros.robots_by" => "rosrust",
            "time.authorities" => {
                let certificate = secret.display();
                return format!("[{{ name = \"One\", url = \"http://h:1/tsa\", certificate = \"{certificate}\" }}]");
            }
            "confirmations" => "3",
            "gateway.admission" => "open",
            "gateway.quota_bytes" => "1GiB",
            "gateway.quota_names" | "gateway.quota_streams" => "5",
            "site.address" => "gate:7420",
            "site.gateway_key" => return "ab".repeat(32),
            "site.also" => return format!("gate2:7420={}", "cd".repeat(32)),
            "console.theme" => "day",
            "console.bytes_per_second" => "9000",
            "console.pictures" => "sixel",
            other => {
                panic!("'{other}' is a new setting: give it a value here, so that its way through a dump is tried")
            }
        }
        .to_owned()
    };
    let names = DEFINITIONS.iter().map(|definition| definition.name);
    names.filter(|name| !OF_THE_MACHINE.contains(name)).map(|name| (name, of(name))).collect()
}

#[test]
fn every_setting_is_in_a_dump_and_comes_back_as_it_was() {
    let examples = examples();
    // Settings that exclude each other are tried separately.
    for without in [&["site.address", "site.also", "alerts.command"][..], &["chain.url", "alerts.webhook"]] {
        let set =
            examples.iter().filter(|(name, _)| !without.contains(name)).map(|(name, value)| (*name, value.clone()));
        let file = SiteFile { settings: set.collect(), ..SiteFile::default() };
        let text = file.to_text(&[]);
        // A file that names a command must be writable by nobody else.
        let own = &file.settings.get("alerts.secret").expect("a private file");
        let again = SiteFile::read(Path::new(own), &text).unwrap_or_else(|error| panic!("{error}\n{text}"));
        assert_eq!(again, file, "{text}");
        let home = home(&text);
        assert_eq!((home.site, home.stays.len()), (file.settings.clone(), 0), "{text}");
        for (name, value) in &file.settings {
            let default = DEFINITIONS.iter().find(|definition| definition.name == *name).expect("known").default;
            assert_ne!(value, default, "{name}: an example that is the default shows nothing");
        }
    }
}

#[test]
fn what_belongs_to_a_machine_or_is_secret_stays_in_its_home() {
    let config = "[ros]\nhost = \"robot\"\n[vault]\nurl = \"redis://u:hunter2@h:1\"\n[crypto]\nsm4_kernel = \"portable\"\n\
                  [console]\ntheme = \"day\"\n";
    let home = home(config);
    let why: Vec<_> = home.stays.iter().map(|(name, (_, why))| (*name, *why)).collect();
    let machine = Stays::OfTheMachine;
    assert_eq!(why, [("crypto.sm4_kernel", machine), ("ros.host", machine), ("vault.url", Stays::Secret)]);
    let dump = SiteFile { settings: home.site.clone(), ..SiteFile::default() };
    assert!(!dump.to_text(&[]).contains("hunter2"));
    assert_eq!(dump.differences(&home, &Here::default()), [], "a dump changes nothing where it comes from");
    assert_eq!(home.wanted(&SiteFile::default()).len(), 3, "and an empty file leaves them alone");
    let other = read("[vault]\nurl = \"redis://h:2\"\n[console]\ntheme = \"day\"\n").expect("a file");
    let told: Vec<String> = other.differences(&home, &Here::default()).iter().map(ToString::to_string).collect();
    assert_eq!(told, ["~ vault.url: (a value with a secret) -> redis://h:2"]);
}

#[test]
fn the_path_of_a_nodes_or_a_webhooks_url_may_be_a_key_and_stays_in_its_home() {
    for (table, key) in [("chain", "url"), ("alerts", "webhook")] {
        let name = format!("{table}.{key}");
        let with = |url: &str| format!("[{table}]\n{key} = \"{url}\"\n");
        for url in ["http://node:8545/v3/hunter2", "http://node/hunter2", "http://node//hunter2", "http://node#hunter2"]
        {
            let home = home(&with(url));
            let stays: Vec<_> = home.stays.iter().map(|(name, (_, why))| (*name, *why)).collect();
            assert_eq!(stays, [(name.as_str(), Stays::Secret)], "{url}");
            let dump = SiteFile { settings: home.site.clone(), ..SiteFile::default() };
            assert!(!dump.to_text(&[]).contains("hunter2"), "{url}");
            assert_eq!(dump.differences(&home, &Here::default()), [], "{url}");
            let other = read(&with("http://other/")).expect("a file").differences(&home, &Here::default());
            let told: Vec<String> = other.iter().map(ToString::to_string).collect();
            assert_eq!(told, [format!("~ {name}: (a value with a secret) -> http://other/")], "{url}");
            let error = read(&with(url)).expect_err(url).to_string();
            assert!(error.contains("site.toml line 2") && !error.contains("hunter2"), "{error}");
        }
        for url in ["http://node:8545", "http://node:8545/", "http://node/api/v2/alerts"] {
            assert!(home(&with(url)).stays.is_empty(), "{url}");
            assert!(read(&with(url)).is_ok(), "{url}");
        }
    }
    for path in ["/var/lib/node.ipc", "ipc:///var/lib/node.ipc"] {
        assert!(home(&format!("[chain]\nurl = \"{path}\"\n")).stays.is_empty(), "{path}: a file, no key");
    }
}

#[test]
fn secrets_and_unknown_keys_are_refused_with_their_lines_and_not_repeated() {
    for (line, text) in [
        (3, "robots = 1\n[chain]\nurl = \"http://me:hunter2@node\"\n"),
        (3, "robots = 1\n[alerts]\nwebhook = \"http://h/?token=hunter2\"\n"),
        (2, "[alerts]\nsecret = \"hunter2hunter2hunter2\"\n"),
        (2, "[console]\ntheme = \"-----BEGIN hunter2\"\n"),
    ] {
        let error = read(text).expect_err(text).to_string();
        assert!(error.contains(&format!("site.toml line {line}")) && !error.contains("hunter2"), "{error}");
    }
    for (line, text) in [
        (3, "[chain]\n\nulr = \"x\"\n"),
        (2, "[keys]\npassphrase = \"hunter2\"\n"),
        (4, "[[watch]]\ntopic = \"/a\"\n[[watch]]\ntopics = \"/b\"\n"),
        (3, "[[watch]]\ntopic = \"/a\"\n[[watch]]\ntype = \"a/B\"\n"),
        (2, "[[watch]]\ntopic = \"a\"\n"),
        (4, "[[watch]]\ntopic = \"/a\"\n\n[[watch]]\ntopic = \"/a\"\n"),
        (3, "[[publisher]]\ntopic = \"/a\"\npublisher = \"x\"\n"),
        (3, "[[contact]]\nname = \"bob\"\naddress = \"0x12\"\n"),
        (1, "watch = 3\n"),
        (2, "[[admitted]]\nowner = 3\n"),
        (3, "[[topic]]\nmatch = \"/a\"\nrates = 1\n"),
        (3, "[console]\n\nmouse = \"perhaps\"\n"),
        (1, "robots = \n"),
    ] {
        let error = read(text).expect_err(text).to_string();
        let place = format!("line {line}");
        assert!(error.contains("site.toml") && error.contains(&place) && !error.contains("hunter2"), "{error}\n{text}");
    }
}

#[test]
fn more_contacts_than_a_home_holds_are_refused_before_anything_is_changed() {
    let contacts = |count: usize| {
        let one = |number: usize| format!("[[contact]]\nname = \"c{number}\"\naddress = \"0x{number:040x}\"\n");
        read(&(1..=count).map(one).collect::<String>())
    };
    assert_eq!(contacts(1_000).expect("as many as a home holds").decisions.contacts.map(|all| all.len()), Some(1_000));
    let error = contacts(1_001).expect_err("one more").to_string();
    assert!(error.contains("more than 1000 [[contact]]"), "{error}");
}

fn full() -> SiteFile {
    let text = format!(
        "[[topic]]\nmatch = \"/robot*/odom\"\ntype = \"nav_msgs/Odometry\"\nrate = 2.5\nevery = 3\nretention = \"1h\"\n\
         tags = {{ mission = \"a \\\"b\\\"\" }}\n[[topic]]\nmatch = \"**\"\nrate = 10\n\
         [[watch]]\ntopic = \"/b\"\n[[watch]]\ntopic = \"/a\"\ntype = \"std_msgs/String\"\n\
         [[publisher]]\ntopic = \"/a\"\npublisher = \"/driver@h:std_msgs/String:992ce8a1687cec8c8bd883ec73ca41d1\"\n\
         [[contact]]\nname = \"bob\"\naddress = \"{BOB}\"\nfingerprint = \"{PRINT}\"\n\
         [[admitted]]\nowner = \"{BOB}\"\n"
    );
    read(&text).expect("a file")
}

/// Rules without their line numbers, which change with what comes before them.
fn unplaced(mut file: SiteFile) -> SiteFile {
    for rule in &mut file.rules.0 {
        std::sync::Arc::make_mut(rule).line = 0;
    }
    file
}

#[test]
fn rules_and_lists_come_back_as_they_were_and_are_written_in_one_order() {
    let file = full();
    let text = file.to_text(&["head".to_owned()]);
    assert!(text.starts_with("# head\n"), "{text}");
    let again = read(&text).unwrap_or_else(|error| panic!("{error}\n{text}"));
    assert_eq!(unplaced(again.clone()), unplaced(file), "{text}");
    assert_eq!(again.to_text(&["head".to_owned()]), text);
    let nothing = Some(BTreeMap::new());
    let empty = SiteFile { decisions: Decisions { watches: nothing, ..Decisions::default() }, ..SiteFile::default() };
    assert_eq!(read(&empty.to_text(&[])).expect("a file").decisions, empty.decisions, "an empty list is a list");
}

#[test]
fn differences_are_what_an_application_changes_and_none_are_left_behind_it() {
    let (file, nothing) = (full(), HomeSettings::default());
    let told: Vec<String> = file.differences(&nothing, &Here::default()).iter().map(ToString::to_string).collect();
    assert_eq!(told.len(), 7, "{told:?}");
    assert_eq!(told.iter().filter(|line| line.starts_with('+')).count(), 7, "{told:?}");
    let (home, mut here) = (
        HomeSettings { rules: file.rules.clone(), ..nothing },
        Here { decisions: file.decisions.clone(), ..Here::default() },
    );
    assert_eq!(file.differences(&home, &here), []);
    // A list that is not mentioned is unchanged; an empty one removes everything.
    let silent = SiteFile { rules: file.rules.clone(), ..SiteFile::default() };
    assert_eq!(silent.differences(&home, &here), []);
    let empty = "watch = []\npublisher = []\ncontact = []\nadmitted = []\n";
    let told: Vec<String> =
        read(empty).expect("a file").differences(&home, &here).iter().map(ToString::to_string).collect();
    assert_eq!(told.iter().filter(|line| line.starts_with('-')).count(), 7, "{told:?}");
    // What a home learnt by itself, and its own accounts, are not differences.
    here.seen_first = here.decisions.publishers.take().unwrap_or_default();
    here.own = here.decisions.admitted.take().unwrap_or_default();
    assert_eq!(file.differences(&home, &here), []);
    let turned = SiteFile { rules: TopicRules(file.rules.0.iter().rev().cloned().collect()), ..SiteFile::default() };
    assert_eq!(turned.differences(&home, &here), [Difference::RulesInOrder]);
}

#[test]
fn what_terminals_act_on_is_spelt_out() {
    let mut file = SiteFile::default();
    file.settings.insert("console.theme", "a\u{1b}[2J\u{202e}\"\\\n".to_owned());
    let text = file.to_text(&[]);
    assert!(text.chars().all(|character| crate::model::is_shown(character) || character == '\n'), "{text:?}");
    assert_eq!(read(&text).expect("a file").settings, file.settings);
}
