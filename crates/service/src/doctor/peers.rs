//! The peers in the settings: Redis, the ROS master and host names.

use std::sync::Arc;
use std::time::{Duration, Instant};

use super::{Sheet, files};
use crate::config::Config;
use crate::model::without_secrets;
use crate::paths::Home;
use crate::ros::ros2::{Reading, Ros2Capture};
use crate::ros::{CaptureNotice, Graph, Message, MessageSink, UNCONFINED};
use crate::store::vault::policy::{self, Gravity};

/// The longest look at a ROS 2 domain.
const LOOK: Duration = Duration::from_secs(6);
const TICK: Duration = Duration::from_millis(50);

/// The vault: the embedded file, or Redis with its policy and persistence.
pub(super) fn vault(home: &Home, config: &Config, sheet: &mut Sheet) {
    let Some(url) = &config.vault_url else {
        return files::database("vault", &home.vault().join("vault.db"), sheet);
    };
    match policy::examine(Some(url)) {
        Ok(findings) => {
            if findings.is_empty() {
                let text = format!("{} answers, does not evict and has an append-only file", without_secrets(url));
                sheet.ok("vault", &text);
            }
            for finding in findings {
                let text = format!("Redis at {} {}", finding.server, finding.text);
                match finding.gravity {
                    Gravity::Warning => sheet.warn("vault", &text, &finding.advice),
                    Gravity::Refused => sheet.fail("vault", &text, &finding.advice),
                }
            }
        }
        Err(error) => {
            let text = error.to_string();
            let (text, advice) = text.split_once(';').unwrap_or((&text, "start it or correct vault.url"));
            sheet.fail("vault", text.trim(), advice.trim());
        }
    }
}

/// Captures nothing: the doctor only looks.
struct Nobody;

impl MessageSink for Nobody {
    fn accept(&self, _: Message) {}
    fn notice(&self, _: CaptureNotice) {}
}

/// The participants of the ROS 2 domain, if the settings name one; it is joined for a moment.
pub(super) fn second(config: &Config, sheet: &mut Sheet) {
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
                  UDP; see docs/ros2.md";
    match &standing.reading {
        Reading::Down { reason } => sheet.fail("ros 2", &standing.text(), &format!("fix what it reports: {reason}")),
        Reading::Looking => {
            sheet.fail("ros 2", &standing.text(), "the program that reads it does not respond; try again")
        }
        Reading::Up if standing.is_empty() => sheet.warn("ros 2", &standing.text(), advice),
        Reading::Up => sheet.ok("ros 2", &standing.text()),
    }
    walls(standing.confined, sheet);
}

/// Whether what parses the network reaches nothing else of this machine.
fn walls(confined: Option<bool>, sheet: &mut Sheet) {
    let advice = "use a kernel of 5.13 or later with landlock among its security modules (/sys/kernel/security/lsm); until \
                  then start the site as root, which gives the program a user of its own";
    match confined {
        Some(true) => sheet.ok("ros 2 walls", "the program that speaks ROS 2 can open no file and no local socket"),
        Some(false) => sheet.warn("ros 2 walls", UNCONFINED, advice),
        None => {}
    }
}

/// The master, this machine's name and the host names given by publishers.
pub(super) fn ros(config: &Config, sheet: &mut Sheet) {
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
            sheet.ok("ros nodes", &format!("all {tried} publishers answer at the addresses they announced"));
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
