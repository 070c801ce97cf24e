//! `robot`: enrolled robots, their policies, and the devices authorised to sign.

#![deny(clippy::wildcard_enum_match_arm)]

use std::io::Read as _;
use std::path::{Path, PathBuf};

use authros_output::{Output, table};
use clap::Subcommand;

use super::agent::{self, EnrolArguments, RunArguments};
use super::args::Global;
use super::connect::Context;
use super::parse;
use super::plan::{self, Plan};
use super::show::{Question, or_dash};
use crate::crypto::keyfile::{load_sm2, sm2_public_from_pem};
use crate::crypto::{LONGEST_POLICY, ProviderName, SmKeyPair, provider, signer_id};
use crate::model::{PublicKey, SignerId, Timestamp, bytes::unhex, clean, counted};
use crate::service::reply::{DeviceRow, RingPullView, RobotRow, RobotTopicRow, RobotView, coverage_legend};
use crate::service::{Failure, command, reply::input};

/// `robot …`
#[derive(Debug, Subcommand)]
pub enum RobotVerb {
    /// Enrol a robot as a device of this profile at a gateway; writes the robot's enrolment file
    Enrol(EnrolArguments),
    /// On a robot: capture and forward everything to its gateway, without a chain
    Run(RunArguments),
    /// List the enrolled robots: last seen, waiting and lost records, policy
    List,
    /// Show one robot: policy, gateway, topics, losses
    Show {
        /// Its name, or the beginning of its device's id
        robot: String,
    },
    /// Show, set or clear a robot's policy, which says what it captures; applied at its next connection
    Policy {
        /// Its name, or the beginning of its device's id
        robot: String,
        /// Set it: a TOML file with [[watch]], [[topic]], ring.keep and ring.topics; - for standard input
        #[arg(long, value_name = "FILE", conflicts_with_all = ["clear", "show"])]
        set: Option<PathBuf>,
        /// Clear it: the robot's own settings apply again
        #[arg(long, conflicts_with = "show")]
        clear: bool,
        /// Show it [default]
        #[arg(long)]
        show: bool,
    },
    /// Fetch unwatched data from a robot's ring, for a time span; it arrives like other records
    Pull {
        /// Its name, or the beginning of its device's id
        robot: String,
        /// Start: 10m (ago), 18:00, "yesterday 18:00", "2026-11-27 18:00" or RFC 3339
        #[arg(long, value_name = "TIME", allow_hyphen_values = true, required_unless_present = "incident")]
        since: Option<String>,
        /// End; same format [default: now]
        #[arg(long, value_name = "TIME", allow_hyphen_values = true)]
        until: Option<String>,
        /// Only these topics; * matches anything but /, ** anything [default: all of the ring]
        #[arg(long = "topic", visible_alias = "topics", value_name = "PATTERN", num_args = 1.., value_delimiter = ',')]
        topics: Vec<String>,
        /// Take the span and topics of this incident unless given
        #[arg(long, value_name = "NAME")]
        incident: Option<String>,
    },
    /// The topics an enrolled robot may record
    #[command(subcommand)]
    Topics(TopicsVerb),
    /// Where an enrolled robot finds its gateway
    #[command(subcommand)]
    Addresses(AddressesVerb),
    /// Authorise a device that is not enrolled to sign for this profile
    Authorise {
        /// Id of the device (64 hex), or the file of its SM2 key (public PEM, or private 0600)
        #[arg(value_name = "ID_OR_KEYFILE")]
        device: String,
        /// End of the authorisation: 30d, 18:00, "tomorrow 18:00", "2026-11-27 18:00" or RFC 3339
        #[arg(long, value_name = "TIME")]
        until: Option<String>,
    },
    /// Revoke a robot or device: it can no longer sign or read, its sessions end, and a new epoch begins
    Revoke {
        /// Name it was enrolled under, its id or the id's first characters, or its fingerprint
        #[arg(value_name = "ROBOT")]
        device: String,
    },
    /// List every device that may sign for this profile, and those revoked, newest first
    Devices,
}

/// `robot topics …`
#[derive(Debug, Subcommand)]
pub enum TopicsVerb {
    /// Give a robot the keys of more topics; it picks them up automatically
    Add {
        /// Name of the robot, or the device's id, its first characters, or its fingerprint
        #[arg(value_name = "ROBOT")]
        device: String,
        /// The topics
        #[arg(value_name = "TOPIC", required = true)]
        topics: Vec<String>,
    },
}

/// `robot addresses …`
#[derive(Debug, Subcommand)]
pub enum AddressesVerb {
    /// Give a robot a further address of its gateway; applied at its next connection
    Add {
        /// Name of the robot, or the device's id, its first characters, or its fingerprint
        #[arg(value_name = "ROBOT")]
        device: String,
        /// The address
        #[arg(value_name = "HOST:PORT")]
        address: String,
    },
}

pub async fn run(global: Global, verb: RobotVerb, output: &Output) -> Result<u8, Failure> {
    let question: Question = match verb {
        RobotVerb::Enrol(arguments) => return agent::enrol(global, arguments, output).await,
        RobotVerb::Run(arguments) => return agent::run(global, arguments, output).await,
        RobotVerb::List => command::ListRobots.into(),
        RobotVerb::Show { robot } => command::ShowRobot { name: robot }.into(),
        RobotVerb::Policy { robot, clear: true, .. } => {
            command::SetRobotPolicy { name: robot, text: String::new() }.into()
        }
        RobotVerb::Policy { robot, set: Some(file), .. } => {
            command::SetRobotPolicy { name: robot, text: policy_of(&file)? }.into()
        }
        // The default.
        RobotVerb::Policy { robot, show: _show, .. } => command::ShowRobot { name: robot }.into(),
        RobotVerb::Pull { robot, since, until, topics, incident } => {
            let times = parse::Times::now(output);
            command::PullRing {
                name: robot,
                since: times.since(since.as_deref())?,
                until: times.until(until.as_deref())?,
                topics: parse::values(&topics)?,
                incident: parse::optional(incident.as_deref())?,
            }
            .into()
        }
        RobotVerb::Topics(TopicsVerb::Add { device, topics }) => {
            command::AddDeviceTopics { device, topics: parse::values(&topics)? }.into()
        }
        RobotVerb::Addresses(AddressesVerb::Add { device, address }) => {
            command::AddDeviceAddress { device, address }.into()
        }
        RobotVerb::Authorise { device, until } => {
            let until = parse::Times::now(output).end(until.as_deref())?;
            command::LendDevice { device: device_of(&device)?, until }.into()
        }
        RobotVerb::Revoke { device } => command::RecallDevice { device }.into(),
        RobotVerb::Devices => command::ListDevices.into(),
    };
    plan::run(Context::new(global, output)?, Plan::unlocked(question), output).await
}

/// Reads at most one byte more than a policy may have.
fn policy_of(file: &Path) -> Result<String, Failure> {
    let shown = clean(&file.display().to_string(), 200);
    let unread = |error: std::io::Error| input(format!("{shown} cannot be read: {error}"));
    let mut text = String::new();
    let most = LONGEST_POLICY as u64 + 1;
    let read = if file.as_os_str() == "-" {
        std::io::stdin().take(most).read_to_string(&mut text)
    } else {
        std::fs::File::open(file).and_then(|file| file.take(most).read_to_string(&mut text))
    };
    read.map_err(unread)?;
    if text.trim().is_empty() {
        let advice = "`robot policy ROBOT --clear` gives a robot back its own settings";
        return Err(input(format!("{shown} is empty; {advice}")));
    }
    Ok(text)
}

pub fn all(robots: &[RobotRow]) -> String {
    if robots.is_empty() {
        return "no robots; enrol one with `authros robot enrol`".to_owned();
    }
    let row = |robot: &RobotRow| {
        [
            robot.name.to_string(),
            or_dash(robot.last_seen),
            or_dash(robot.address.as_ref()),
            robot.waiting.to_string(),
            robot.lost.to_string(),
            or_dash(Some(robot.wanted).filter(|version| *version > 0)),
            or_dash(robot.running),
            robot.standing.clone(),
            robot.drift_since.map_or_else(String::new, |since| format!("out of date since {since}")),
        ]
    };
    let head = ["robot", "last seen", "gateway", "waiting", "lost", "wanted", "runs", "policy", ""];
    table(&head, robots.iter().map(row))
}

pub fn one(view: &RobotView) -> String {
    let row = &view.row;
    let wanted = match (row.wanted, view.set_at) {
        (0, _) => "no policy was set".to_owned(),
        (version, at) => format!("policy {version}, set {}: {}", or_dash(at), row.standing),
    };
    let mut lines = vec![
        format!("robot '{}', device {}", row.name, row.device),
        format!("last seen {}; waiting here: {}", or_dash(row.last_seen), counted(row.waiting, "record")),
        wanted,
    ];
    lines.extend(row.running.map(|running| format!("it runs version {running}")));
    lines.extend(row.drift_since.map(|since| format!("out of date since {since}")));
    lines.extend(view.refused.iter().map(|why| format!("it refused: {why}")));
    lines.extend(view.overruled.iter().map(|what| format!("overridden on the robot: {what}")));
    lines.extend(view.gateway.iter().flat_map(|one| &one.addresses).map(|address| format!("gateway {address}")));
    let cells = |topic: &RobotTopicRow| {
        let counts = [topic.records, topic.verified, topic.waiting, topic.lost].map(|count| count.to_string());
        let ends = [topic.first, topic.last].map(|at| or_dash(at.map(Timestamp::in_milliseconds)));
        [vec![topic.topic.clone()], counts.to_vec(), ends.to_vec(), vec![topic.strip.clone()]].concat()
    };
    if !view.topics.is_empty() {
        let head = ["topic", "messages", "verified", "waiting", "lost", "first", "last", "coverage"];
        lines.push(table(&head, view.topics.iter().map(cells)));
    }
    lines.extend(view.covered.map(|span| {
        let signs: String = view.topics.iter().map(|topic| topic.strip.as_str()).collect();
        let (since, until) = (span.since.in_milliseconds(), span.until.in_milliseconds());
        format!("coverage from {since} to {until}, {} per sign: {}", span.part(), coverage_legend(&signs))
    }));
    if !view.policy.is_empty() {
        lines.push(format!("\n{}", view.policy.trim_end()));
    }
    lines.join("\n")
}

pub fn pulled(view: &RingPullView) -> String {
    let topics = if view.topics.is_empty() { "all its topics".to_owned() } else { view.topics.join(", ") };
    format!(
        "requested from robot '{}': what its ring has of {topics} from {} to {}; at its next connection it sends what \
         is still there",
        view.robot, view.since, view.until
    )
}

/// Longest key file read, bytes.
const LONGEST: u64 = 16 * 1024;

fn device_of(text: &str) -> Result<SignerId, Failure> {
    let path = Path::new(text);
    if path.is_file() {
        return Ok(signer_id(&public_key(path)?));
    }
    unhex(text).and_then(|bytes| SignerId::from_slice(&bytes)).ok_or_else(|| {
        let advice = "a fingerprint alone is not enough to authorise a device; give the key file";
        input(format!("give a device as 64 hex characters or as the file of its SM2 key; {advice}"))
    })
}

fn public_key(path: &Path) -> Result<PublicKey, Failure> {
    let broken = |error: std::io::Error| input(format!("{}: {error}", path.display()));
    if std::fs::metadata(path).map_err(broken)?.len() > LONGEST {
        return Err(input(format!("{} is too long to be a key", path.display())));
    }
    let bytes = std::fs::read(path).map_err(broken)?;
    if String::from_utf8_lossy(&bytes).contains("BEGIN PUBLIC KEY") {
        return Ok(sm2_public_from_pem(&String::from_utf8_lossy(&bytes))?);
    }
    let secret = load_sm2(path)?;
    Ok(SmKeyPair::from_secret(provider(ProviderName::default()), secret)?.public)
}

pub fn devices(rows: &[DeviceRow]) -> String {
    let row = |row: &DeviceRow| {
        [
            row.device.to_string(),
            row.fingerprint.clone(),
            row.state.clone(),
            row.from.to_string(),
            or_dash(row.until),
            or_dash(row.recalled),
        ]
    };
    let head = ["device", "fingerprint", "state", "from block", "until", "revoked at"];
    let mut newest_first: Vec<&DeviceRow> = rows.iter().collect();
    newest_first.sort_by_key(|row| std::cmp::Reverse(row.from));
    table(&head, newest_first.into_iter().map(row))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_device_is_named_by_its_id_or_its_key() {
        let home = tempfile::tempdir().expect("folder");
        let pair = SmKeyPair::generate(provider(ProviderName::default())).expect("pair");
        let id = signer_id(&pair.public);
        let public = home.path().join("device.pem");
        std::fs::write(&public, crate::crypto::keyfile::sm2_public_pem(&pair.public).expect("pem")).expect("written");
        let private = home.path().join("device.key");
        let pem = crate::crypto::keyfile::sm2_pem(&pair.secret).expect("pem");
        crate::crypto::private_file::create_private(&private, pem.as_bytes()).expect("written");
        for name in [id.to_string(), format!("0x{id}"), public.display().to_string(), private.display().to_string()] {
            assert_eq!(device_of(&name).ok(), Some(id), "{name}");
        }
        assert!(device_of(&id.to_string()[..32]).is_err() && device_of("nowhere.pem").is_err());
        std::fs::write(&public, "no key").expect("written");
        assert!(device_of(&public.display().to_string()).is_err());
    }
}
