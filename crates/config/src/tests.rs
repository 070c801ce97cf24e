//! Settings: which source wins, and the errors for invalid ones.

use std::path::Path;

use super::*;
use crate::model::SignerId;

fn none(_: &str) -> Option<String> {
    None
}

fn with_file(text: &str) -> Result<Config, ConfigError> {
    Config::resolve(&none, &none, Some((Path::new("config.toml"), text)))
}

#[test]
fn nothing_set_is_all_embedded() {
    let config = Config::resolve(&none, &none, None).expect("defaults");
    assert_eq!((config.ros_master, config.chain_url, config.cache_url), (None, None, None));
    assert_eq!((config.robots, config.confirmations, config.meter), (4, 1, MeterMode::All));
}

#[test]
fn flag_beats_environment_beats_file() {
    let file = "robots = 1\n[chain]\nurl = \"http://file\"\n";
    let environment = |name: &str| {
        (name == "AUTHROS_ROBOTS" || name == "AUTHROS_CHAIN")
            .then(|| if name == "AUTHROS_ROBOTS" { "2".to_owned() } else { "http://env".to_owned() })
    };
    let flags = |name: &str| (name == "robots").then(|| "3".to_owned());
    let config = Config::resolve(&flags, &environment, Some((Path::new("c"), file))).expect("resolves");
    assert_eq!((config.robots, config.chain_url.as_deref()), (3, Some("http://env")));
    assert_eq!(config.source("robots"), Source::Flag);
    assert_eq!(with_file(file).expect("file").source("chain.url"), Source::File(3));
}

#[test]
fn a_real_master_means_no_robots() {
    let config = with_file("[ros]\nmaster = \"http://127.0.0.1:11311\"\n").expect("file");
    assert_eq!((config.robots, config.meter), (0, MeterMode::Watched));
}

#[test]
fn unknown_keys_and_bad_values_name_the_place() {
    let error = with_file("robots = 1\n[ros]\nmastr = \"x\"\n").expect_err("unknown");
    assert_eq!(error, ConfigError::Unknown { file: "config.toml".into(), line: 3, name: "ros.mastr".into() });
    let later = with_file("version = 2\nrobots = 1").expect_err("later").to_string();
    assert!(later.contains("config.toml line 1") && later.contains("use a newer authros"), "{later}");
    let first = with_file("robots = 1\nversion = 1").expect_err("no setting").to_string();
    assert!(first.contains("config.toml line 2") && first.contains("remove it"), "{first}");
    assert!(with_file("robots = 99").expect_err("range").to_string().contains("config.toml line 1"));
    assert!(matches!(with_file("robots = "), Err(ConfigError::Syntax { .. })));
    assert!(with_file("[cache]\nurl = \"ftp://x\"").is_err());
    assert!(with_file("[chain]\ncontract = \"0x12\"").is_err());
}

#[test]
fn an_unknown_word_is_refused_with_those_that_are_known() {
    for (name, known) in [
        ("ros.meter", &["all", "watched", "auto"][..]),
        ("ros.pins", &["first", "list", "off"]),
        ("ros.publisher", &["own", "rosrust"]),
        ("ros.robots_by", &["own", "rosrust"]),
        ("chain.consensus", &["poa", "pow"]),
        ("record.compression", &["auto", "off"]),
        ("crypto.provider", &["authros", "rustcrypto", "libsm"]),
        ("crypto.sm4_kernel", &["gfni-avx512", "gfni-avx2", "aesni-avx2", "portable"]),
        ("anchor.mode", &["batch", "each"]),
        ("metrics.open", &["yes", "no"]),
        ("metrics.topics", &["yes", "no"]),
        ("alerts.form", &["authros", "alertmanager"]),
        ("gateway.admission", &["open", "closed"]),
        ("site.trust_first", &["yes", "no"]),
        ("console.ascii", &["yes", "no", "auto"]),
        ("console.mouse", &["yes", "no"]),
        ("console.pictures", &["half-blocks", "sixel", "kitty"]),
    ] {
        for unknown in ["every", known[0].to_uppercase().as_str()] {
            let told = with_file(&format!("{name} = \"{unknown}\"")).expect_err(name).to_string();
            assert!(told.starts_with(name) && known.iter().all(|word| told.contains(word)), "{told}");
        }
        for word in known {
            with_file(&format!("{name} = \"{word}\"")).expect(word);
        }
    }
}

#[test]
fn a_remote_site_is_an_address_and_whom_to_trust() {
    let site = |text: &str| with_file(text).map(|config| config.site);
    assert_eq!(site(""), Ok(None));
    let key = "ab".repeat(32);
    let text = format!("[site]\naddress = \"gate.example:4222\"\ngateway_key = \"{key}\"\n");
    let named = site(&text).expect("file").expect("a site");
    assert_eq!((named.addresses, named.trust_first), (vec!["gate.example:4222".to_owned()], false));
    assert_eq!(named.gateway_key, Some(SignerId([0xab; 32])));
    let at = |text: &str| site(&format!("[site]\naddress = \"{text}\"\ngateway_key = \"{key}\"\n"));
    let named = at("gate:1, b.example:1,[::1]:2").expect("file").expect("a site");
    assert_eq!(named.addresses, ["gate:1", "b.example:1", "[::1]:2"]);
    for bad in ["gate:1,", "gate:1,b", "gate:1 b:1", &["gate:1"; 9].join(",")] {
        assert!(at(bad).is_err(), "{bad}");
    }
    let error = at(&format!("gate:1,b:1={}", "01".repeat(32))).expect_err("another gateway").to_string();
    assert!(error.contains("a site has one gateway"), "{error}");
    assert!(site("[site]\naddress = \"[::1]:4222\"\ntrust_first = \"yes\"").expect("file").is_some());
    for bad in ["host", ":1", "host:", "host:70000", "ho st:1", "http://host:1"] {
        assert!(site(&format!("[site]\naddress = \"{bad}\"")).is_err(), "{bad}");
    }
    assert!(site("[site]\naddress = \"h:1\"\ngateway_key = \"ab\"").is_err());
    let fingerprint = format!("[site]\naddress = \"h:1\"\ngateway_key = \"{}\"\n", ["abcd"; 8].join(" "));
    let error = site(&fingerprint).expect_err("half a key").to_string();
    assert!(error.contains("this is the fingerprint"), "{error}");
    assert!(site("[site]\naddress = \"h:1\"\ntrust_first = \"maybe\"").is_err());
    let error = site("[chain]\nurl = \"http://node\"\n[site]\naddress = \"h:1\"").expect_err("both");
    assert!(error.to_string().contains("chain.url"), "{error}");
}

#[test]
fn pictures_are_half_blocks_unless_it_is_said_otherwise() {
    let pictures = |text: &str| with_file(text).map(|config| config.console.pictures);
    assert_eq!(pictures(""), Ok(Pictures::HalfBlocks));
    for (word, wanted) in
        [("half-blocks", Pictures::HalfBlocks), ("sixel", Pictures::Sixel), ("kitty", Pictures::Kitty)]
    {
        assert_eq!(pictures(&format!("[console]\npictures = \"{word}\"")), Ok(wanted));
    }
    let error = pictures("[console]\npictures = \"auto\"").expect_err("never guessed").to_string();
    assert!(error.contains("config.toml line 2") && error.contains("sixel or kitty"), "{error}");
}

#[test]
fn a_refused_url_shows_no_secret_path() {
    let refused = with_file("[chain]\nurl = \"gopher://me:hunter2@node.example.org/v3/SECRETKEY?also=it\"\n");
    let told = refused.expect_err("no such scheme").to_string();
    assert!(told.contains("node.example.org/…"), "{told}");
    assert!(!["SECRETKEY", "also", "hunter2"].iter().any(|secret| told.contains(secret)), "{told}");
}

#[test]
fn the_lowest_price_is_no_higher_than_the_highest() {
    let config = with_file("[chain]\nmin_price = 5\nmax_fee = 5\n").expect("equal");
    assert_eq!((config.min_price, config.max_fee), (5_000_000_000, Some(5_000_000_000)));
    assert_eq!(with_file("").expect("defaults").min_price, 0);
    let without_cap = with_file("[chain]\nmin_price = 5000\nmax_fee = \"\"\n").expect("no cap");
    assert_eq!((without_cap.min_price, without_cap.max_fee), (5_000_000_000_000, None));
    let told = with_file("[chain]\nmin_price = 6\nmax_fee = 5\n").expect_err("above the cap").to_string();
    assert!(told.contains("chain.min_price") && told.contains("chain.max_fee") && told.contains("gwei"), "{told}");
    for name in ["max_fee", "min_price"] {
        let told = with_file(&format!("[chain]\n{name} = \"cheap\"\n")).expect_err(name).to_string();
        assert!(told.contains("a whole number of gwei per gas from 0 to 1000000000"), "{told}");
    }
}

#[test]
fn passwords_are_hidden() {
    for text in [
        "[cache]\nurl = \"redis://u:hunter2@127.0.0.1:1\"",
        "[store]\nurl = \"postgres://u:hunter2@127.0.0.1:1/fleet\"",
    ] {
        let config = with_file(text).expect("file");
        let shown = serde_json::to_string(&config.show()).expect("json");
        assert!(!shown.contains("hunter2") && shown.contains("127.0.0.1:1"), "{shown}");
    }
    for url in [
        "mysql://u:hunter2@h/x",
        "host=h password=hunter2",
        "host=h password=a://hunter2",
        "postgres:u:hunter2@h",
        "hunter2",
    ] {
        let told = with_file(&format!("[store]\nurl = \"{url}\"")).expect_err(url).to_string();
        assert!(told.contains("store.url") && told.contains("postgres://") && !told.contains("hunter2"), "{told}");
    }
    let told = with_file("robots = 1\n[store]\nurl = \"postgres://u:hunter2@h/x\n").expect_err("no end").to_string();
    assert!(told.contains("line 3") && !told.contains("hunter2"), "{told}");
}

#[test]
fn a_home_that_joins_a_gateway_has_no_database() {
    let both = "[store]\nurl = \"postgres://u:hunter2@h/x\"\n[site]\naddress = \"h:1\"\ntrust_first = \"yes\"\n";
    let told = with_file(both).expect_err("both").to_string();
    assert!(told.contains("store.url") && told.contains("site.address") && !told.contains("hunter2"), "{told}");
    let each = "[store]\nurl = \"postgres://h/x\"\n[anchor]\nmode = \"each\"\n";
    assert!(with_file(each).expect_err("many owners").to_string().contains("choose batch"));
    let config = with_file("[store]\nurl = \"postgresql://h,i/x\"\n").expect("a gateway's");
    assert_eq!(config.store_url.as_deref(), Some("postgresql://h,i/x"));
}

/// With `AUTHROS_WRITE_SETTINGS` the page's list is written anew.
#[test]
fn the_manual_lists_the_settings_as_they_are_defined() {
    const PAGE: &str = concat!(env!("CARGO_MANIFEST_DIR"), "/../../docs/settings.md");
    const LIST: (&str, &str) = ("<!-- settings -->\n", "<!-- /settings -->");
    let row = |Definition { name, variable, default, text }: &Definition| {
        let default = if default.is_empty() { String::new() } else { format!(", `{default}`") };
        format!("- **{name}** (`{variable}`{default}): {}\n", text.replace('*', "\\*"))
    };
    let rows: String = DEFINITIONS.iter().map(row).collect();
    let page = std::fs::read_to_string(PAGE).expect("docs/settings.md");
    let (before, rest) = page.split_once(LIST.0).expect("where the list begins");
    let (listed, after) = rest.split_once(LIST.1).expect("where it ends");
    if std::env::var_os("AUTHROS_WRITE_SETTINGS").is_some() {
        std::fs::write(PAGE, [before, LIST.0, &rows, LIST.1, after].concat()).expect("written");
        return;
    }
    assert!(listed == rows, "run it with AUTHROS_WRITE_SETTINGS=1, and read what that changes");
}
