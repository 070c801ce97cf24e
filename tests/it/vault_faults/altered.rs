//! Values altered in Redis behind the program's back: all of it is found, and none of it is shown.

use serde_json::Value;

use super::field::{Load, NO_REDIS, ODOM};
use crate::support::{Redis, skipped, text};

/// How the values of two keys are altered.
const WAYS: [(&str, &str); 6] = [
    (
        "flipped",
        "local v=redis.call('GET',KEYS[1]); local n=tonumber(ARGV[1])%#v+1; local b=string.byte(v,n); \
      redis.call('SET',KEYS[1],string.sub(v,1,n-1)..string.char(bit.bxor(b,1))..string.sub(v,n+1))",
    ),
    (
        "swapped",
        "local a=redis.call('GET',KEYS[1]); local b=redis.call('GET',KEYS[2]); \
      redis.call('SET',KEYS[1],b); redis.call('SET',KEYS[2],a)",
    ),
    ("truncated", "redis.call('SET',KEYS[1],string.sub(redis.call('GET',KEYS[1]),1,-1-ARGV[1]%50-1))"),
    ("emptied", "redis.call('SET',KEYS[1],'')"),
    ("lengthened", "redis.call('APPEND',KEYS[1],'x')"),
    ("deleted", "redis.call('DEL',KEYS[1])"),
];

#[test]
fn every_alteration_is_found_and_no_plaintext_is_shown() {
    let Some(redis) = Redis::start(&[]) else { skipped!(NO_REDIS) };
    let load = Load::start(&["--vault", &redis.url()], &[], &[]);
    load.authros.capture(&[ODOM], 2 * WAYS.len() as u64);
    let records = load.authros.records(&["uploads", "list"]);
    let key = |record: &Value| format!("authros:{}", text(record, "digest"));
    for (index, (pair, (way, script))) in records.chunks(2).zip(WAYS).enumerate() {
        let [one, other] = pair else { panic!("two records each") };
        redis.cli(&["EVAL", script, "2", &key(one), &key(other), &(index * 37 + 11).to_string()]);
        let id = text(one, "id");
        let check = load.authros.with(&["--json"]).run(&["shared", "check", &id]).expect_code(6);
        let expected = if way == "deleted" { "missing" } else { "tampered" };
        assert_eq!(check.document()["verdict"], expected, "{way}: {check}");
        let open = load.authros.with(&["--json"]).run(&["shared", "open", &id]).expect_code(6);
        let document = open.document();
        assert!(document["message"].is_null() && document["fields"].is_null(), "{way}: {open}");
        assert!(!open.stdout.contains("position"), "{way}: {open}");
        let other = if way == "swapped" { 6 } else { 0 };
        load.authros.run(&["shared", "check", &text(&pair[1], "id")]).expect_code(other);
    }
    load.end();
}
