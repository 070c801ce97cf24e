//! `authros demo`: the paper's crime-scene mission, told with figures. Four robots, of ROS 1 or ROS 2, take odometry
//! and pictures; CURA A shares them with CURA B, a stranger and a forger are refused, B is
//! revoked. Every figure is counted, none is assumed; `ok` says that all of them are right.

mod listener;
mod locks;
mod mission;
#[cfg(test)]
mod secrets;
#[cfg(test)]
mod tests;

use serde::Serialize;

use self::mission::Mission;
use super::args::DemoArguments;
use super::connect::Context;
use crate::config::Config;
use crate::model::ErrorKind;
use crate::paths::Home;
use crate::service::Failure;
use authros_output::Output;

/// Robots of ROS 2, unless `--robots` says otherwise.
const USUAL_ROBOTS: u16 = 4;

/// Transactions and gas of the mission, including deployment and registration.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize)]
pub struct Work {
    /// Transactions in blocks.
    pub transactions: u64,
    /// Gas they used.
    pub gas: u64,
}

/// The demo's output.
#[derive(Debug, Clone, PartialEq, Eq, Default, Serialize)]
pub struct Story {
    /// Messages captured by CURA A.
    pub captured: u64,
    /// Of these in a block.
    pub anchored: u64,
    /// Of these re-read and checked against the chain.
    pub verified: u64,
    /// Records that CURA B opened while granted.
    pub opened_by_grantee: u64,
    /// Whether the stranger got nothing.
    pub refused_stranger: bool,
    /// Whether the flipped bit and every other forgery was refused, each by its own check.
    pub refused_tampered: bool,
    /// Records sealed after the revocation that CURA B opened with every key it kept.
    pub opened_after_revoke: u64,
    /// Pictures that CURA B restored byte-identical to what the robot sent.
    pub restored_images: u64,
    /// Messages lost in transport or in the recorder.
    pub lost: u64,
    /// The chain's work.
    pub chain: Work,
    /// Whether everything is as it must be.
    pub ok: bool,
}

/// Runs the demo; exit 0 with `ok: true`, otherwise 1.
///
/// # Errors
/// If a step cannot be taken at all.
pub async fn run(mut context: Context, arguments: DemoArguments, output: &Output) -> Result<u8, Failure> {
    if context.config.robots == 0 && context.global.ros2.is_none() {
        return Err(Failure::new(
            ErrorKind::Usage,
            "the demo needs robots; use --robots 1 to 32 and no real ROS master",
        ));
    }
    let temporary = match context.global.home {
        Some(_) => None,
        None => Some(temporary_home(&mut context, "authros-demo-")?),
    };
    let robots = if context.global.ros2.is_some() { in_domain(&mut context) } else { Robots::of_one(&context.config) };
    let mission = Mission::start(&context, robots, arguments.seconds, *output).await?;
    let told = mission.run().await;
    drop(temporary);
    let story = told?;
    output.result(&story, || text(&story));
    Ok(if story.ok { 0 } else { ErrorKind::Internal.exit_code() })
}

/// The robots of a mission.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Robots {
    /// Their number.
    pub number: u16,
    /// The ROS 2 domain in which they publish; `None` for the embedded master of ROS 1.
    pub domain: Option<u16>,
}

impl Robots {
    /// As the settings say, at the embedded master.
    pub fn of_one(config: &Config) -> Self {
        Self { number: config.robots, domain: None }
    }
}

/// The robots are in the domain that the site captures, and none at its master: one name is captured from one graph.
fn in_domain(context: &mut Context) -> Robots {
    let number = std::mem::take(&mut context.config.robots);
    let number = if number == 0 { USUAL_ROBOTS } else { number };
    Robots { number, domain: context.config.ros_domain }
}

/// Gives a context a home of its own, which is removed with the value, and default settings.
///
/// # Errors
/// If none can be created.
pub(super) fn temporary_home(context: &mut Context, prefix: &str) -> Result<tempfile::TempDir, Failure> {
    let directory = tempfile::Builder::new().prefix(prefix).tempdir();
    let directory = directory
        .map_err(|error| Failure::new(ErrorKind::Home, format!("no temporary directory can be created: {error}")))?;
    context.home = Home::new(directory.path().to_owned());
    context.operator = None;
    context.global.site_socket = None;
    // The settings of the standard home do not apply to this one.
    let global = context.global.clone();
    context.config = Config::resolve(&|name| global.setting(name), &|name| std::env::var(name).ok(), None)?;
    Ok(directory)
}

fn yes(value: bool) -> &'static str {
    if value { "yes" } else { "NO" }
}

fn text(story: &Story) -> String {
    [
        String::new(),
        format!("  captured             {:>8}", story.captured),
        format!("  anchored             {:>8}", story.anchored),
        format!("  verified             {:>8}", story.verified),
        format!("  lost                 {:>8}", story.lost),
        format!("  opened by grantee    {:>8}", story.opened_by_grantee),
        format!("  pictures restored    {:>8}  byte-identical", story.restored_images),
        format!("  stranger refused     {:>8}", yes(story.refused_stranger)),
        format!("  tampering refused    {:>8}", yes(story.refused_tampered)),
        format!("  opened after revoke  {:>8}", story.opened_after_revoke),
        format!("  chain                {:>8}  transactions, {} gas", story.chain.transactions, story.chain.gas),
        format!("  {}", if story.ok { "everything as expected" } else { "NOT as expected" }),
    ]
    .join("\n")
}
