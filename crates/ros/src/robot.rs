//! Simulated robots: `/robotN/odom` (`nav_msgs/Odometry`) and `/robotN/camera/compressed`
//! (`sensor_msgs/CompressedImage`), each robot a ROS node of its own, or all of them one participant of a ROS 2 domain.
//!
//! They speak TCPROS like any node, or DDS, so that capture cannot tell them from real ones. Their messages are invented; they
//! are marked as simulated where they are shown and sealed.

mod cdr;
mod definitions;
mod domain;
mod letters;
mod messages;
mod picture;
mod rosrust;
mod track;

use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

use super::RosError;
use super::address::{Endpoint, own_host};
use super::publisher::{Advertised, Outlet, PublisherNode};
use crate::model::Timestamp;

use picture::Camera;
use track::Track;

pub use domain::DomainFleet;
pub use rosrust::RosrustFleet;

pub use definitions::{COMPRESSED_IMAGE, ODOMETRY, compressed_image_definition, odometry_definition};

/// The most robots in a fleet.
pub const MOST_ROBOTS: u16 = 64;

/// The fastest publishing rate, Hz.
const FASTEST: f64 = 1000.0;

/// How long starting waits for the master.
const PATIENCE: Duration = Duration::from_secs(2);

/// How long subscribers get for the rest of their queues at the end.
const FAREWELL: Duration = Duration::from_secs(1);

/// How often the robots publish.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct FleetOptions {
    /// Odometry messages per second and robot.
    pub odometry_hz: f64,
    /// Pictures per second and robot.
    pub picture_hz: f64,
}

impl Default for FleetOptions {
    fn default() -> Self {
        Self { odometry_hz: 20.0, picture_hz: 2.0 }
    }
}

/// Running robots. They unregister and end on drop; what is queued for subscribers is sent first.
pub struct Fleet {
    nodes: Vec<PublisherNode>,
    stopping: Arc<AtomicBool>,
    threads: Vec<JoinHandle<()>>,
}

impl Fleet {
    /// Starts `robots` robots, numbered from 1, at the master.
    ///
    /// # Errors
    /// [`RosError::Robots`] beyond [`MOST_ROBOTS`], [`RosError::Rate`] for an invalid rate, and failures of master,
    /// sockets and threads.
    pub fn start(master_uri: &str, robots: u16, options: FleetOptions) -> Result<Self, RosError> {
        if robots > MOST_ROBOTS {
            return Err(RosError::Robots(robots));
        }
        let periods = (period(options.odometry_hz)?, period(options.picture_hz)?);
        let master = Endpoint::parse(master_uri).ok_or_else(|| RosError::address(master_uri))?;
        let host = own_host(None, &master, Instant::now() + PATIENCE)?;
        let mut fleet = Self { nodes: Vec::new(), stopping: Arc::default(), threads: Vec::new() };
        for number in 1..=robots {
            fleet.add(&master, &host, number, periods)?;
        }
        Ok(fleet)
    }

    /// The robots' topics and how many messages were published on each, with or without subscribers: the first has
    /// `header.seq` 0, the last this count minus 1.
    pub fn published(&self) -> Vec<(String, u64)> {
        let outlets = self.nodes.iter().flat_map(PublisherNode::outlets);
        outlets.map(|outlet| (outlet.topic().to_owned(), outlet.published())).collect()
    }

    /// Total messages that a subscriber missed because it read too slowly.
    pub fn overflowed(&self) -> u64 {
        self.nodes.iter().map(PublisherNode::overflowed).sum()
    }

    /// Ends publishing and returns the final counts; then like dropping.
    pub fn stop(mut self) -> Vec<(String, u64)> {
        self.end_publishing();
        self.published()
    }

    fn add(
        &mut self,
        master: &Endpoint,
        host: &str,
        number: u16,
        periods: (Duration, Duration),
    ) -> Result<(), RosError> {
        let outlets = [
            outlet(format!("/robot{number}/odom"), ODOMETRY, odometry_definition()),
            outlet(format!("/robot{number}/camera/compressed"), COMPRESSED_IMAGE, compressed_image_definition()),
        ];
        let [odometry, pictures] = outlets.map(Arc::new);
        let both = vec![Arc::clone(&odometry), Arc::clone(&pictures)];
        self.nodes.push(PublisherNode::start(master.clone(), host, format!("/robot{number}_sim"), both)?);
        let track = Track::of_robot(number);
        self.publish("robot-odometry", odometry, periods.0, move |seq, age| {
            Some(messages::odometry(seq, Timestamp::now(), &track.at(age)))
        })?;
        let mut camera = Camera::new(number, track);
        self.publish("robot-camera", pictures, periods.1, move |seq, age| {
            camera.shoot(seq, age).map(|jpeg| messages::compressed_image(seq, Timestamp::now(), number, &jpeg))
        })
    }

    /// Publishes what `make` returns for number and age (seconds), once per period.
    fn publish(
        &mut self,
        name: &str,
        outlet: Arc<Outlet>,
        period: Duration,
        mut make: impl FnMut(u32, f64) -> Option<Vec<u8>> + Send + 'static,
    ) -> Result<(), RosError> {
        let publish = move |seq, age| make(seq, age).inspect(|body| outlet.publish(body)).is_some();
        self.threads.push(repeat(name, period, &self.stopping, publish)?);
        Ok(())
    }

    fn end_publishing(&mut self) {
        self.stopping.store(true, Ordering::SeqCst);
        for thread in self.threads.drain(..) {
            thread.thread().unpark();
            let _ = thread.join();
        }
    }
}

impl Drop for Fleet {
    fn drop(&mut self) {
        self.end_publishing();
        for node in &self.nodes {
            node.close(FAREWELL);
        }
    }
}

/// Does `work` with number and age (seconds) once per period, in a thread; what it does counts if it returns true.
fn repeat(
    name: &str,
    period: Duration,
    stopping: &Arc<AtomicBool>,
    mut work: impl FnMut(u32, f64) -> bool + Send + 'static,
) -> Result<JoinHandle<()>, RosError> {
    let stopping = Arc::clone(stopping);
    let work = move || {
        let begun = Instant::now();
        let mut due = begun;
        let mut seq = 0u32;
        while wait_until(due, &stopping) {
            if work(seq, begun.elapsed().as_secs_f64()) {
                seq = seq.wrapping_add(1);
            }
            // After the machine was suspended continue from now: no burst of missed messages.
            due = (due + period).max(Instant::now().checked_sub(period).unwrap_or(due));
        }
    };
    let thread = std::thread::Builder::new().name(name.into()).spawn(work);
    thread.map_err(|error| RosError::system("start a thread", &error))
}

/// A topic of ours, by its definition.
fn about(topic: String, type_name: &str, definition: String) -> Advertised {
    let (type_name, md5sum) = (type_name.to_owned(), definitions::sum_of(type_name, &definition));
    Advertised { topic, type_name, md5sum, definition, latching: false }
}

fn outlet(topic: String, type_name: &str, definition: String) -> Outlet {
    Outlet::new(about(topic, type_name, definition))
}

fn period(hz: f64) -> Result<Duration, RosError> {
    if hz > 0.0 && hz <= FASTEST {
        Duration::try_from_secs_f64(1.0 / hz).map_err(|_| RosError::Rate(hz.to_string()))
    } else {
        Err(RosError::Rate(hz.to_string()))
    }
}

/// Sleeps until `due`; `false` once stopping.
fn wait_until(due: Instant, stopping: &AtomicBool) -> bool {
    while !stopping.load(Ordering::SeqCst) {
        let left = due.saturating_duration_since(Instant::now());
        if left.is_zero() {
            return true;
        }
        std::thread::park_timeout(left);
    }
    false
}
