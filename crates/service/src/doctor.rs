//! Checks everything a home depends on: files, chain, peers. Needs no passphrase and changes nothing; an embedded part
//! that is not running is fine. A running site is asked about its own peers: its settings may be others than these.

use std::path::Path;
use std::sync::Arc;
use std::time::{Duration, Instant};

use crate::chain::{Chain, ChainOptions, Endpoint, Pin, SealedBy};
use crate::config::Config;
use crate::crypto::read_public;
use crate::durability::worth;
use crate::model::{ErrorKind, Timestamp, clean, coarse, counted, grouped, without_secrets};
use crate::paths::Home;
use crate::pipeline::{network_pin_at, network_pin_in};
use crate::reply::{ChainView, CheckStatus, DoctorCheck, DoctorView, HealthLevel, LifeLine, PartHealth, SiteView};
use crate::ros::ros2::{Reading, Ros2Capture};
use crate::ros::{CaptureNotice, Graph, Message, MessageSink, UNCONFINED};
use crate::site::{
    STORE_LOST, is_bound, join_key, keyring_faults, lease_standing, misses_store, other_gateway, store_loss,
};
use crate::store::notes::{HoldersSettings, ProfileAccounts, SharedSystemKeys, StoreWasGone};
use crate::store::{CacheSettings, Glance, SiteLock, StoreError, cache, files, snapshot};

/// What a running site says of itself, and of its chain if that answers.
pub struct Running {
    pub site: SiteView,
    pub chain: Option<Box<ChainView>>,
}

/// `site`: a running site, or why it does not answer; `None` if none runs.
pub async fn examine(home: &Home, config: &Config, site: Option<Result<Running, String>>) -> DoctorView {
    let mut sheet = Sheet::default();
    let runs = site.is_some();
    // No site can start while its files are checked.
    let lock = if runs { None } else { SiteLock::acquire(&home.site_lock()).ok().flatten() };
    tokio::task::block_in_place(|| {
        home_folder(home, &mut sheet);
        keys(home, &mut sheet);
        if config.store_url.is_none() {
            store(home, config, &mut sheet);
        }
        disk(home, &mut sheet);
    });
    let (mut peers, mut code) = (Sheet::default(), None);
    let pinned = tokio::task::block_in_place(|| pin_of(home, config, runs, &mut peers));
    match site {
        Some(Ok(running)) => {
            code = running.site.worst();
            of_site(&running, &mut peers);
        }
        Some(Err(reason)) => {
            let advice = "stop the process that holds site.lock, then start the site again";
            peers.fail("site", &format!("it does not answer: {reason}"), advice);
        }
        None => {
            tokio::task::block_in_place(|| {
                cache(config, &mut peers);
                ros_master(config, &mut peers);
                second(config, &mut peers);
            });
            look(home, config, pinned, &mut peers).await;
            peers.ok("site", "no site is running; start one with `authros serve` or the console");
        }
    }
    drop(lock);
    let local = sheet.has_failed().then_some(ErrorKind::Incomplete);
    // As `status` ends for the same state.
    let code = code.or(local).or_else(|| peers.has_failed().then_some(ErrorKind::Unreachable));
    sheet.checks.append(&mut peers.checks);
    DoctorView { ok: code.is_none(), kind: code, checks: sheet.checks }
}

/// Health of a home's peers if no site of it runs.
pub async fn peers(home: &Home, config: &Config) -> Vec<PartHealth> {
    let (mut ros, mut chain) = (Sheet::default(), Sheet::default());
    tokio::task::block_in_place(|| ros_master(config, &mut ros));
    let mut store = Sheet::default();
    let pinned = tokio::task::block_in_place(|| pin_of(home, config, false, &mut store));
    look(home, config, pinned, &mut chain).await;
    let embedded = config.ros_master.is_none();
    let site = "no site is running; start one with `authros serve` or the console";
    let store = config.store_url.is_some().then(|| store.health("store", HealthLevel::Ok));
    let mut parts = vec![
        ros.health("ros", if embedded { HealthLevel::Absent } else { HealthLevel::Ok }),
        chain.health("chain", HealthLevel::Ok),
    ];
    parts.extend(store);
    parts.push(PartHealth::new("site", HealthLevel::Absent, site));
    parts
}

fn of_site(running: &Running, sheet: &mut Sheet) {
    let Running { site, chain } = running;
    for part in &site.health {
        let name = format!("site {}", part.part);
        let (detail, advice) = advised(&part.text).unwrap_or((part.text.as_str(), usual_advice(&part.part)));
        match part.level {
            HealthLevel::Ok | HealthLevel::Absent => sheet.ok(&name, &part.text),
            HealthLevel::Waiting => sheet.warn(&name, detail, advice),
            HealthLevel::Failed => sheet.fail(&name, detail, advice),
        }
    }
    if let Some(chain) = chain.as_ref().filter(|chain| chain.contract.is_some()) {
        let (sealers, difficulty) = (chain.sealing.sealers.len(), chain.sealing.difficulty.as_deref());
        who_seals(&SealedBy::of(&chain.client, &chain.consensus, sealers, difficulty), sheet);
    }
    let LifeLine { verified, pending, tampered, conserved, .. } = site.life;
    if tampered > 0 || !conserved {
        let text = format!("altered or missing: {}; or the counts do not balance", counted(tampered, "record"));
        return sheet.fail("site", &text, "authros audit lists them; keep a copy of the home");
    }
    sheet.ok(
        "site",
        &format!("running; {} of this profile verified, {} pending", counted(verified, "record"), grouped(pending)),
    );
}

/// What is wrong, and what to do: a text has the second after a semicolon, or before a colon if it names a command.
fn advised(text: &str) -> Option<(&str, &str)> {
    let first = text.split_once(": ").filter(|(advice, _)| advice.contains('`'));
    first.map(|(advice, what)| (what, advice)).or_else(|| text.split_once("; "))
}

/// Where a part does not say what to do.
fn usual_advice(part: &str) -> &'static str {
    match part {
        "chain" => "start the node again, or correct chain.url; the site then continues automatically",
        "ros" => "start roscore, or correct ros.master; the site then continues automatically",
        "gateway" => "check the gateway's address and this machine's network; the site connects again automatically",
        _ => "the site's log has the reason; if it stays, stop the site and start it again",
    }
}

#[derive(Debug, Default)]
struct Sheet {
    checks: Vec<DoctorCheck>,
}

impl Sheet {
    fn add(&mut self, name: &str, status: CheckStatus, detail: &str, advice: &str) {
        let (name, detail, advice) = (clean(name, 60), clean(detail, 600), clean(advice, 600));
        self.checks.push(DoctorCheck { name, status, detail, advice });
    }

    fn ok(&mut self, name: &str, detail: &str) {
        self.add(name, CheckStatus::Ok, detail, "");
    }

    fn warn(&mut self, name: &str, detail: &str, advice: &str) {
        self.add(name, CheckStatus::Warn, detail, advice);
    }

    fn fail(&mut self, name: &str, detail: &str, advice: &str) {
        self.add(name, CheckStatus::Fail, detail, advice);
    }

    /// `otherwise` where the text itself does not say what to do.
    fn fail_in_words(&mut self, name: &str, text: &str, otherwise: &str) {
        let (detail, advice) = advised(text).unwrap_or((text, otherwise));
        self.fail(name, detail, advice);
    }

    /// The first failure, or the first finding and `well`.
    fn health(&self, name: &str, well: HealthLevel) -> PartHealth {
        let failed = self.checks.iter().find(|check| check.status == CheckStatus::Fail);
        match failed {
            Some(check) => PartHealth::new(name, HealthLevel::Failed, &format!("{}; {}", check.detail, check.advice)),
            None => PartHealth::new(name, well, self.checks.first().map_or("", |check| check.detail.as_str())),
        }
    }

    fn has_failed(&self) -> bool {
        self.checks.iter().any(|check| check.status == CheckStatus::Fail)
    }
}

/// Seconds that a block may be ahead of this clock.
const AHEAD: u64 = 15;
/// Seconds beyond which things break: grants begin and end by the chain's time.
const FAR_AHEAD: u64 = 120;

const EMBEDDED: &str = "embedded";

type PinResult = Result<Option<Pin>, StoreError>;

/// Also looks at the database of a gateway's home.
fn pin_of(home: &Home, config: &Config, runs: bool, sheet: &mut Sheet) -> PinResult {
    match &config.store_url {
        None => network_pin_in(&home.ledger()),
        Some(url) => database(home, config, (url, runs), sheet).map_or(Ok(None), |glance| network_pin_at(&glance)),
    }
}

async fn look(home: &Home, config: &Config, pinned: PinResult, sheet: &mut Sheet) {
    let pinned = match pinned {
        Ok(pinned) => pinned,
        Err(error) => return sheet.fail_in_words("chain", &error.to_string(), DAMAGED),
    };
    if let Some(site) = &config.site {
        return remote(&site.addresses, sheet).await;
    }
    let (endpoint, name) = match &config.chain_url {
        Some(url) => (Endpoint::Node { url: url.clone(), roots: config.chain_roots.clone() }, without_secrets(url)),
        None if pinned.is_none() && !home.chain().join("chain.db").exists() => {
            return sheet.ok("chain", "embedded; created with the first registration");
        }
        None => (Endpoint::Embedded { directory: home.chain(), consensus: config.consensus }, EMBEDDED.to_owned()),
    };
    let has_pin = pinned.is_some();
    let options = ChainOptions { endpoint, contract: config.contract, pinned };
    match Chain::connect(options).await {
        Ok(chain) => answered(&chain, &name, has_pin, sheet).await,
        Err(error) => {
            sheet.fail_in_words("chain", &error.to_string(), usual_advice("chain"));
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
        None if name == EMBEDDED && head.number > 0 => {
            let blocks = counted(head.number, "block");
            let text = format!("the embedded chain has {blocks}, and this home's store names no contract on it");
            let advice = "the store was lost: restore the last backup, or name the contract with --contract";
            sheet.fail("contract", &text, advice);
        }
        None => sheet
            .ok("contract", "not deployed yet; deploy it with `authros identity register` or `authros chain deploy`"),
    }
    if has_pin && let Ok(sealed_by) = chain.sealed_by().await {
        who_seals(&sealed_by, sheet);
    }
    let now = Timestamp::now().seconds();
    let ahead = head.timestamp.saturating_sub(now);
    let advice = "run `timedatectl set-ntp true` here; if this clock is right, the chain's sealers must correct theirs";
    let text = format!("the newest block is {} ahead of this machine's clock", coarse(Duration::from_secs(ahead)));
    if ahead >= FAR_AHEAD {
        sheet.fail("clock", &text, advice);
    } else if ahead >= AHEAD {
        sheet.warn("clock", &text, advice);
    } else {
        let age = coarse(Duration::from_secs(now.saturating_sub(head.timestamp)));
        sheet.ok("clock", &format!("the newest block is {age} old by this machine's clock; none is in the future"));
    }
}

/// Whether the anchors hold against the chain's operator, too.
fn who_seals(sealed_by: &SealedBy, sheet: &mut Sheet) {
    if sealed_by.alone {
        let text = format!("records are anchored on a chain sealed by a single party: {}", sealed_by.text);
        let advice = "if that is not sufficient evidence, set chain.url to a chain sealed by several parties";
        sheet.warn("sealers", &text, advice);
    } else {
        sheet.ok("sealers", &sealed_by.text);
    }
}

/// One address that answers is enough; the others cause a warning.
async fn remote(addresses: &[String], sheet: &mut Sheet) {
    let patience = Duration::from_secs(3);
    let mut silent = Vec::new();
    for address in addresses {
        match tokio::time::timeout(patience, tokio::net::TcpStream::connect(address)).await {
            Ok(Ok(_)) => {
                let text = format!("through the gateway at {address}, which answers");
                if silent.is_empty() {
                    return sheet.ok("chain", &text);
                }
                let text = format!("{text}; {}", silent.join("; "));
                return sheet.warn("chain", &text, "check that line, or site.address");
            }
            Ok(Err(error)) => silent.push(format!("the gateway at {address}: {error}")),
            Err(_) => silent.push(format!("the gateway at {address} does not answer within {} s", patience.as_secs())),
        }
    }
    sheet.fail("chain", &silent.join("; "), "start it or correct site.address");
}

/// Bytes; with less, a site soon stops acknowledging.
const TIGHT: u64 = 1 << 30;
/// Bytes; with less, it cannot work.
const FULL: u64 = 32 << 20;

fn home_folder(home: &Home, sheet: &mut Sheet) {
    let root = home.root();
    if !root.exists() {
        return sheet.ok("home", &format!("{} does not exist yet; it is created on first use", root.display()));
    }
    if let Err(error) = files::private_directory(root) {
        return sheet.fail("home", &error.to_string(), "make it writable for this user, or choose another --home");
    }
    let (mut open, mut looked) = (Vec::new(), 0);
    look_at_modes(root, &mut open, &mut looked, 0);
    match open.first() {
        None => {
            sheet.ok("home", &format!("{} and what it holds are private: {}", root.display(), counted(looked, "path")))
        }
        Some(first) => {
            let advice = format!("chmod -R go= '{}'", root.display());
            sheet.fail(
                "home",
                &format!(
                    "accessible to others: {} of {}; {first}",
                    grouped(open.len() as u64),
                    counted(looked, "path")
                ),
                &advice,
            );
        }
    }
}

fn look_at_modes(path: &Path, open: &mut Vec<String>, looked: &mut u64, depth: usize) {
    *looked += 1;
    match files::mode_advice(path) {
        // Settings and themes contain no secrets.
        Ok(Some(_)) if depth == 1 && !is_secret(path) => {}
        Ok(Some(advice)) => open.push(advice),
        Ok(None) | Err(_) => {}
    }
    let is_directory = path.symlink_metadata().is_ok_and(|about| about.is_dir());
    if is_directory && depth < 6 {
        for entry in std::fs::read_dir(path).into_iter().flatten().flatten() {
            look_at_modes(&entry.path(), open, looked, depth + 1);
        }
    }
}

fn is_secret(path: &Path) -> bool {
    let name = path.file_name().unwrap_or_default().to_string_lossy();
    ["profiles", "chain", "gateway", "ledger.db"].iter().any(|begin| name.starts_with(begin))
}

fn keys(home: &Home, sheet: &mut Sheet) {
    let mut profiles = home.profiles();
    let known = Glance::at(&home.ledger()).and_then(|ledger| ledger.note(&ProfileAccounts {})).ok().flatten();
    let faults = keyring_faults(home, known.unwrap_or_default());
    for (profile, fault) in &faults {
        sheet.fail_in_words(&format!("keys {profile}"), fault, DAMAGED);
    }
    profiles.retain(|one| !faults.iter().any(|(profile, _)| profile == one));
    if profiles.is_empty() && faults.is_empty() {
        sheet.warn("keys", "no profile has keys yet", "authros identity create");
    }
    for profile in profiles {
        if let Ok(public) = read_public(&home.keyring(&profile)) {
            sheet.ok(&format!("keys {profile}"), &format!("account {}", public.address));
        }
    }
}

const DAMAGED: &str = "keep a copy of the home, then restore the last backup: `authros backup restore FILE`";

/// Whether the store is well-formed and its notes can be read.
fn store(home: &Home, config: &Config, sheet: &mut Sheet) {
    let path = home.ledger();
    if misses_store(home) {
        let text = format!("{} is gone, although this home has keys or an embedded chain", path.display());
        return sheet.fail("store", &text, STORE_LOST);
    }
    if !path.exists() {
        return sheet.ok("store", &format!("{} does not exist yet", path.display()));
    }
    let bytes = match snapshot::examine(&path) {
        Ok(bytes) => bytes,
        Err(error) => return sheet.fail_in_words("store", &error.to_string(), DAMAGED),
    };
    let glance = Glance::at(&path);
    let missed = glance.as_ref().ok().and_then(|ledger| ledger.note(&StoreWasGone {}).ok().flatten());
    match missed.filter(|_| !is_bound(home, config)) {
        Some(missed) => sheet.fail("store", &store_loss(home, missed), STORE_LOST),
        None => sheet.ok("store", &format!("{} is well-formed, {}", path.display(), counted(bytes, "byte"))),
    }
    notes(glance.and_then(|ledger| ledger.check_notes()), sheet);
}

fn notes(checked: Result<u64, StoreError>, sheet: &mut Sheet) {
    match checked {
        Ok(count) => sheet.ok("notes", &format!("the store's notes are readable: {}", grouped(count))),
        Err(error) => sheet.fail_in_words("notes", &error.to_string(), DAMAGED),
    }
}

const OTHER_DATABASE: &str = "correct store.url";

/// A gateway's database, looked at without a change; returned if it has the store's tables. A site that `runs` speaks of the
/// lease itself.
fn database(home: &Home, config: &Config, (url, runs): (&str, bool), sheet: &mut Sheet) -> Option<Glance> {
    if url.contains('@')
        && let Ok(Some(advice)) = files::mode_advice(&home.config())
    {
        sheet.warn("settings", "others can read the settings, which may have the password of store.url", &advice);
    }
    let watermark = home.watermark();
    let look = |watermark| Glance::on_server(url, config.store_roots.as_deref(), watermark);
    let foreign = |glance: &Glance| {
        let known = glance.note(&ProfileAccounts {}).ok().flatten().unwrap_or_default();
        other_gateway(&known, glance.path(), home)
    };
    // Another gateway's database never counted this home's commits.
    let looked = look(Some(&watermark)).or_else(|error| match look(None) {
        Ok((Some(glance), durability)) if foreign(&glance).is_some() => Ok((Some(glance), durability)),
        _ => Err(error),
    });
    let (glance, durability) = match looked {
        Ok(found) => found,
        Err(error) => {
            sheet.fail_in_words("store", &error.to_string(), OTHER_DATABASE);
            return None;
        }
    };
    let (level, text) = worth(&durability, config.store_standbys);
    match level {
        HealthLevel::Failed => sheet.fail_in_words("store", &text, OTHER_DATABASE),
        HealthLevel::Ok | HealthLevel::Absent | HealthLevel::Waiting => sheet.ok("store", &text),
    }
    let Some(glance) = glance else {
        sheet.ok("notes", "the database is empty; `authros gateway serve` makes its tables");
        return None;
    };
    notes(glance.check_notes(), sheet);
    workers(&glance, config, runs, sheet);
    if let Some(text) = foreign(&glance) {
        sheet.fail_in_words("database", &text, OTHER_DATABASE);
    } else if let Ok(Some(shared)) = glance.note(&SharedSystemKeys {})
        && let Err(failure) = join_key(home, shared.join)
    {
        sheet.fail("join key", &failure.message, "run `authros gateway join FILE` with a new join file");
    }
    Some(glance)
}

fn workers(glance: &Glance, config: &Config, runs: bool, sheet: &mut Sheet) {
    match glance.lease().map(|lease| lease.filter(|_| !runs).map(|lease| lease_standing(&lease))) {
        Ok(Some((HealthLevel::Failed, text))) => sheet.warn("lease", &text, "`authros gateway serve` takes it"),
        Ok(Some((_, text))) => sheet.ok("lease", &text),
        Ok(None) => {}
        Err(error) => sheet.fail_in_words("lease", &error.to_string(), DAMAGED),
    }
    let unlike = config.unlike(&glance.note(&HoldersSettings {}).ok().flatten().unwrap_or_default());
    if !unlike.is_empty() {
        let text = format!("they differ from those of the worker that held the lease last: {}", unlike.join(", "));
        sheet.warn("settings", &text, "set them alike at all workers, then start those again that were changed");
    }
}

fn disk(home: &Home, sheet: &mut Sheet) {
    let mut place = home.root();
    while !place.exists() {
        let Some(parent) = place.parent() else { break };
        place = parent;
    }
    let place = if place.as_os_str().is_empty() { Path::new(".") } else { place };
    match files::free_bytes(place) {
        Ok(free) => {
            let text = format!("{} MiB are free at {}", free >> 20, place.display());
            match free {
                0..FULL => sheet.fail("disk", &text, "free some space; nothing is acknowledged on a full disk"),
                FULL..TIGHT => sheet.warn("disk", &text, "free some space before it is full"),
                _ => sheet.ok("disk", &text),
            }
        }
        Err(error) => sheet.warn("disk", &error.to_string(), "check with `df`"),
    }
}

const LOOK: Duration = Duration::from_secs(6);
const TICK: Duration = Duration::from_millis(50);

fn cache(config: &Config, sheet: &mut Sheet) {
    let Some(url) = config.cache_url.clone() else { return };
    match cache::examine(&CacheSettings { url, roots: config.cache_roots.clone() }) {
        Ok(shown) => sheet.ok("cache", &format!("{shown} answers")),
        Err(StoreError::CacheAway { url, detail }) => {
            let advice = "start it, correct cache.url, or leave that empty; records are read from the store meanwhile";
            sheet.warn("cache", &format!("{url} does not answer: {detail}"), advice);
        }
        Err(error) => sheet.fail("cache", &error.to_string(), "correct cache.url and cache.roots in the settings"),
    }
}

struct Nobody;

impl MessageSink for Nobody {
    fn accept(&self, _: Message) {}
    fn notice(&self, _: CaptureNotice) {}
}

/// Joins the ROS 2 domain of the settings for a moment.
fn second(config: &Config, sheet: &mut Sheet) {
    let Some(domain) = config.ros_domain.filter(|_| config.site.is_none()) else { return };
    let capture = match Ros2Capture::start(domain, config.ros2_program.as_deref(), Arc::new(Nobody)) {
        Ok(capture) => capture,
        Err(error) => return sheet.fail("ros 2", &error.to_string(), "install it, or clear ros.domain"),
    };
    let begun = Instant::now();
    while begun.elapsed() < LOOK && capture.standing().reading == Reading::Looking {
        std::thread::sleep(TICK);
    }
    let standing = capture.standing();
    let advice = "start a robot there; on the robot, unset FASTDDS_BUILTIN_TRANSPORTS and ROS_DISCOVERY_SERVER and use \
                  UDP; see docs/robots.md";
    match &standing.reading {
        Reading::Down { reason } => {
            sheet.fail("ros 2", &standing.text(), &format!("fix the reported problem: {reason}"))
        }
        Reading::Looking => {
            sheet.fail("ros 2", &standing.text(), "the program that reads it does not respond; try again")
        }
        Reading::Up if standing.is_empty() => sheet.warn("ros 2", &standing.text(), advice),
        Reading::Up => sheet.ok("ros 2", &standing.text()),
    }
    walls(standing.confined, sheet);
}

/// Whether the process that parses the network can reach anything else of this machine.
fn walls(confined: Option<bool>, sheet: &mut Sheet) {
    let advice = "use a kernel of 5.13 or later with landlock among its security modules (/sys/kernel/security/lsm); until \
                  then start the site as root, which gives the program a user of its own";
    match confined {
        Some(true) => sheet.ok("ros 2 walls", "the program that speaks ROS 2 can open no file and no local socket"),
        Some(false) => sheet.warn("ros 2 walls", UNCONFINED, advice),
        None => {}
    }
}

fn ros_master(config: &Config, sheet: &mut Sheet) {
    if config.site.is_some() {
        return sheet.ok("ros", "is at the gateway");
    }
    let Some(master) = &config.ros_master else {
        return sheet.ok("ros", "embedded master, started with the site");
    };
    let shown = without_secrets(master);
    let graph = match Graph::new(master, "/authros_doctor") {
        Ok(graph) => graph,
        Err(error) => return sheet.fail("ros", &error.to_string(), "correct ros.master"),
    };
    match graph.ping() {
        Ok(()) => sheet.ok("ros", &format!("the master at {shown} answers")),
        Err(error) => return sheet.fail("ros", &error.to_string(), "start roscore or correct ros.master"),
    }
    match graph.own_name(config.ros_host.as_deref()) {
        Ok(host) => sheet.ok("ros host", &format!("this machine announces itself to other nodes as {host}")),
        Err((host, reason)) => {
            let advice = "set ROS_HOSTNAME (or ros.host) to a name or address at which robots can reach this machine";
            sheet.fail("ros host", &format!("{host} {reason}"), advice);
        }
    }
    match graph.unreached() {
        Ok((tried, unreached)) if unreached.is_empty() => {
            sheet.ok(
                "ros nodes",
                &format!("answering at the address that it announced: {}", counted(tried as u64, "publisher")),
            );
        }
        Ok((tried, unreached)) => {
            let one = |node: &crate::ros::graph::Unreached| format!("{} at {}: {}", node.node, node.place, node.reason);
            let texts: Vec<String> = unreached.iter().map(one).collect();
            let advice = "on that machine, set ROS_HOSTNAME or ROS_IP to something that resolves here, or remove the \
                          dead node with rosnode cleanup";
            sheet.warn("ros nodes", &format!("{} of {tried}: {}", unreached.len(), texts.join("; ")), advice);
        }
        Err(error) => sheet.warn("ros nodes", &error.to_string(), "check with `rosnode list`"),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_text_has_its_advice_behind_a_semicolon_or_first_if_that_is_a_command() {
        let node = "retry in 4 s: the node at http://h does not answer; start it, or correct chain.url";
        let (what, advice) = advised(node).expect("advice");
        assert_eq!(
            (what, advice),
            ("retry in 4 s: the node at http://h does not answer", "start it, or correct chain.url")
        );
        let clock =
            advised("run `timedatectl set-ntp true`: this clock is 3 d behind the chain; wait").expect("advice");
        assert_eq!(clock, ("this clock is 3 d behind the chain; wait", "run `timedatectl set-ntp true`"));
        assert_eq!(advised("connecting to http://h"), None);
    }
}
