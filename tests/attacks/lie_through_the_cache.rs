//! Someone who has the Redis in front of a store gives readers what he likes: one record in another's place, an altered one, an
//! older or a longer one.

use crate::support::{Home, Redis, count, skipped, text, wait_until};
use crate::{Outcome, judge};

const TOPIC: &str = "/robot1/odom";

/// What he does with the values of two keys.
const LIES: [&str; 5] = [
    "local a=redis.call('GET',KEYS[1]); redis.call('SET',KEYS[1],redis.call('GET',KEYS[2])); redis.call('SET',KEYS[2],a)",
    "local v=redis.call('GET',KEYS[1]); redis.call('SET',KEYS[1],string.sub(v,1,-2)..string.char(bit.bxor(string.byte(v,-1),1)))",
    "redis.call('SET',KEYS[1],redis.call('GET',KEYS[2]))",
    "redis.call('SET',KEYS[1],'')",
    "redis.call('APPEND',KEYS[1],string.rep('x',1000000))",
];

#[test]
fn lie_through_the_cache() {
    let Some(redis) = Redis::start(&[]) else { skipped!("no redis-server and redis-cli") };
    let home = Home::new();
    let authros = home.authros().with(&["--robots", "1", "--cache", &redis.url()]);
    let _site = authros.serve(&home);
    authros.enrol();
    authros.capture(&[TOPIC], 2);
    let records = authros.records(&["records", "list", "--oldest"]);
    let [one, other] = [0, 1].map(|index| text(&records[index], "id"));
    let keys = [0, 1].map(|index| format!("authros:{}", text(&records[index], "digest")));
    let open = |id: &str| authros.json(&["records", "open", id]);
    let truth = [open(&one), open(&other)].map(|opened| opened["message"].clone());
    assert_ne!(truth[0], truth[1]);
    let state = || authros.json(&["status"])["cache"].clone();
    let mut shown = Vec::new();
    for lie in LIES {
        // As it was before the lie.
        wait_until(60, "both are in the cache", || {
            let misses = count(&state(), "misses");
            open(&one);
            open(&other);
            (count(&state(), "misses") == misses).then_some(())
        });
        let wrong = count(&state(), "wrong");
        redis.cli(&["EVAL", lie, "2", &keys[0], &keys[1]]);
        let seen = [open(&one), open(&other)].map(|opened| opened["message"].clone());
        if seen != truth {
            shown.push(format!("{lie}: {seen:?}"));
        }
        assert!(count(&state(), "wrong") > wrong, "it was told: {}", state());
    }
    let outcome = match shown.is_empty() {
        true => {
            Outcome::Refused(format!("{} false answers of the cache were counted and none was shown", state()["wrong"]))
        }
        false => Outcome::Succeeded(shown.join("; ")),
    };
    judge("lie_through_the_cache", outcome);
}
