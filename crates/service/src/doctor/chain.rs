//! The chain: does it answer, is it the pinned one, does the contract's code match the pin, and do the clocks agree.

use super::Sheet;
use crate::chain::{Chain, ChainOptions, Endpoint, Pin, SealedBy};
use crate::config::Config;
use crate::model::{Timestamp, without_secrets};
use crate::paths::Home;

/// Seconds that a block may be ahead of this clock.
const AHEAD: u64 = 15;
/// Seconds beyond which things break: grants begin and end by the chain's time.
const FAR_AHEAD: u64 = 120;

/// Checks it.
pub(super) async fn look(home: &Home, config: &Config, site_runs: bool, sheet: &mut Sheet) {
    let pinned = match pin(home) {
        Ok(pinned) => pinned,
        Err(reason) => return sheet.fail("chain", &reason, "restore chain-pin.json from a backup"),
    };
    if let Some(site) = &config.site {
        return remote(&site.addresses, sheet).await;
    }
    let (endpoint, name) = match &config.chain_url {
        Some(url) => (Endpoint::Node { url: url.clone(), roots: config.chain_roots.clone() }, without_secrets(url)),
        None if site_runs && (pinned.is_none() || home.chain().join("chain.db").exists()) => {
            sheet.ok("chain", "embedded; in use by the running site");
            return if pinned.is_some() {
                who_seals(&SealedBy::embedded(), sheet)
            };
        }
        None if pinned.is_none() && !home.chain().join("chain.db").exists() => {
            return sheet.ok("chain", "embedded; created with the first registration");
        }
        None => {
            let endpoint = Endpoint::Embedded { directory: home.chain(), consensus: config.consensus };
            (endpoint, "embedded".to_owned())
        }
    };
    let has_pin = pinned.is_some();
    let options = ChainOptions { endpoint, contract: config.contract, pinned, confirmations: config.confirmations };
    match Chain::connect(options).await {
        Ok(chain) => answered(&chain, &name, has_pin, sheet).await,
        Err(error) => {
            let text = error.to_string();
            let (text, advice) = text.split_once(';').unwrap_or((&text, "start the node or correct chain.url"));
            sheet.fail("chain", text.trim(), advice.trim());
        }
    }
}

async fn answered(chain: &Chain, name: &str, has_pin: bool, sheet: &mut Sheet) {
    let head = match chain.head().await {
        Ok(head) => head,
        Err(error) => return sheet.fail("chain", &error.to_string(), "check the node"),
    };
    sheet.ok("chain", &format!("{name}, chain id {}, block {}", chain.chain_id(), head.number));
    match chain.pin() {
        Some(pin) if has_pin => {
            let (contract, hash) = (pin.contract, pin.code_hash);
            sheet.ok("contract", &format!("{contract}, its code matches the pinned hash {hash}"));
        }
        Some(pin) => sheet.ok("contract", &format!("{}, its code matches this program", pin.contract)),
        None => sheet.ok("contract", "none yet; deploy it with `authros register` or `authros chain deploy`"),
    }
    if has_pin && let Ok(sealed_by) = chain.sealed_by().await {
        who_seals(&sealed_by, sheet);
    }
    let now = Timestamp::now().seconds();
    let ahead = head.timestamp.saturating_sub(now);
    let advice = "correct this machine's clock (timedatectl set-ntp true) or that of the chain's sealers";
    let text = format!("the newest block is {ahead} s ahead of this machine's clock");
    if ahead >= FAR_AHEAD {
        sheet.fail("clock", &text, advice);
    } else if ahead >= AHEAD {
        sheet.warn("clock", &text, advice);
    } else {
        let age = now.saturating_sub(head.timestamp);
        sheet.ok("clock", &format!("the newest block is {age} s old by this machine's clock; none is in the future"));
    }
}

/// Records are anchored on it: whether that holds against its operator, too.
fn who_seals(sealed_by: &SealedBy, sheet: &mut Sheet) {
    if sealed_by.alone {
        let text = format!("records are anchored on a chain sealed by a single party: {}", sealed_by.text);
        sheet.warn(
            "sealers",
            &text,
            "if that is not sufficient evidence, set chain.url to a chain sealed by several parties",
        );
    } else {
        sheet.ok("sealers", &sealed_by.text);
    }
}

/// The first address that answers will do; the others are told in a warning.
async fn remote(addresses: &[String], sheet: &mut Sheet) {
    let patience = std::time::Duration::from_secs(3);
    let mut silent = Vec::new();
    for address in addresses {
        match tokio::time::timeout(patience, tokio::net::TcpStream::connect(address)).await {
            Ok(Ok(_)) => {
                let text = format!("through the gateway at {address}, which answers");
                return match silent.as_slice() {
                    [] => sheet.ok("chain", &text),
                    _ => sheet.warn(
                        "chain",
                        &format!("{text}; {}", silent.join("; ")),
                        "check that line, or site.address",
                    ),
                };
            }
            Ok(Err(error)) => silent.push(format!("the gateway at {address}: {error}")),
            Err(_) => {
                silent.push(format!("the gateway at {address} does not answer within {} s", patience.as_secs()));
            }
        }
    }
    sheet.fail("chain", &silent.join("; "), "start it or correct site.address");
}

fn pin(home: &Home) -> Result<Option<Pin>, String> {
    match std::fs::read(home.pin()) {
        Ok(bytes) => serde_json::from_slice(&bytes).map(Some).map_err(|_| "chain-pin.json is damaged".to_owned()),
        Err(error) if error.kind() == std::io::ErrorKind::NotFound => Ok(None),
        Err(error) => Err(format!("chain-pin.json cannot be read: {error}")),
    }
}
