//! The chain of a whole mission, searched for everything that must never be on it.

use clap::Parser as _;

use super::{Mission, Robots};
use crate::cli::args::Arguments;
use crate::cli::connect::Context;
use authros_output::Output;

fn contains(hay: &[u8], needle: &[u8]) -> bool {
    hay.windows(needle.len()).any(|window| window == needle)
}

#[tokio::test(flavor = "multi_thread")]
async fn the_chain_of_a_mission_holds_no_secret() {
    let home = tempfile::tempdir().expect("directory");
    let path = home.path().to_str().expect("path");
    let arguments = Arguments::try_parse_from([
        "authros",
        "--store-passphrase",
        "--home",
        path,
        "--robots",
        "2",
        "tour",
        "--plain",
    ])
    .expect("arguments");
    let context = Context::new(arguments.global, &Output::new(false)).expect("context");
    let robots = Robots { number: context.config.robots, domain: None };
    let mut mission = Mission::start(&context, robots, 4, Output::new(true)).await.expect("starts");
    let story = mission.play().await.expect("played");
    assert!(story.ok, "{story:?}");
    let dump = mission.chain_dump().await.expect("dump");
    let secrets = mission.secrets().await.expect("secrets");
    assert!(secrets.len() > 40, "{} secrets", secrets.len());
    let on_chain = |needle: &[u8]| dump.iter().any(|bytes| contains(bytes, needle));
    for (name, secret) in &secrets {
        assert!(secret.len() >= 5, "{name} is too short to be searched for");
        assert!(!on_chain(secret), "{name} is on the chain");
    }
    // The search itself works: what must be there is found.
    let anchors = mission.some_anchors().expect("anchors");
    assert!(!anchors.is_empty());
    for anchor in anchors {
        assert!(on_chain(anchor.as_bytes()), "{anchor} is not on the chain");
    }
    mission.end().await;
}
