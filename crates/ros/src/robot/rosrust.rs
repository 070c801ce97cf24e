//! The same robots as nodes of another library: each is rosrust in a process of its own.

use std::path::Path;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex, PoisonError};
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

use super::picture::Camera;
use super::track::Track;
use super::{
    COMPRESSED_IMAGE, FAREWELL, FleetOptions, MOST_ROBOTS, ODOMETRY, about, compressed_image_definition, messages,
    odometry_definition, period, repeat,
};
use crate::model::Timestamp;
use crate::ros::{Advertised, RosError, RosrustPublisher};

/// Running robots. They leave the graph on drop; what is queued for subscribers is sent first.
pub struct RosrustFleet {
    nodes: Vec<Arc<Mutex<RosrustPublisher>>>,
    stopping: Arc<AtomicBool>,
    threads: Vec<JoinHandle<()>>,
}

fn locked(node: &Mutex<RosrustPublisher>) -> std::sync::MutexGuard<'_, RosrustPublisher> {
    node.lock().unwrap_or_else(PoisonError::into_inner)
}

impl RosrustFleet {
    /// Starts `robots` robots, numbered from 1, at the master; `program` names the program in which rosrust runs if it is
    /// not beside this one.
    ///
    /// # Errors
    /// [`RosError::Robots`] beyond [`MOST_ROBOTS`], [`RosError::Rate`] for an invalid rate, [`RosError::NoRosrust`] if that
    /// program is missing, [`RosError::NotPublishedByRosrust`] if it cannot publish there.
    pub fn start(
        master_uri: &str,
        program: Option<&Path>,
        robots: u16,
        options: FleetOptions,
    ) -> Result<Self, RosError> {
        if robots > MOST_ROBOTS {
            return Err(RosError::Robots(robots));
        }
        let periods = (period(options.odometry_hz)?, period(options.picture_hz)?);
        let mut fleet = Self { nodes: Vec::new(), stopping: Arc::default(), threads: Vec::new() };
        for number in 1..=robots {
            let node = RosrustPublisher::start(master_uri, None, &format!("robot{number}_sim"), program)?;
            fleet.add(node, number, periods)?;
        }
        Ok(fleet)
    }

    fn add(&mut self, mut node: RosrustPublisher, number: u16, periods: (Duration, Duration)) -> Result<(), RosError> {
        let odometry = about(format!("/robot{number}/odom"), ODOMETRY, odometry_definition());
        let camera = format!("/robot{number}/camera/compressed");
        let pictures = about(camera, COMPRESSED_IMAGE, compressed_image_definition());
        for topic in [&odometry, &pictures] {
            node.advertise(topic, false)?;
        }
        let node = Arc::new(Mutex::new(node));
        self.nodes.push(Arc::clone(&node));
        let track = Track::of_robot(number);
        self.publish("robot-odometry", (&node, odometry), periods.0, move |seq, age| {
            Some(messages::odometry(seq, Timestamp::now(), &track.at(age)))
        })?;
        let mut camera = Camera::new(number, track);
        self.publish("robot-camera", (&node, pictures), periods.1, move |seq, age| {
            camera.shoot(seq, age).map(|jpeg| messages::compressed_image(seq, Timestamp::now(), number, &jpeg))
        })
    }

    fn publish(
        &mut self,
        name: &str,
        (node, about): (&Arc<Mutex<RosrustPublisher>>, Advertised),
        period: Duration,
        mut make: impl FnMut(u32, f64) -> Option<Vec<u8>> + Send + 'static,
    ) -> Result<(), RosError> {
        let node = Arc::clone(node);
        let publish = move |seq, age| {
            let message = make(seq, age);
            message.is_some_and(|message| {
                let mut node = locked(&node);
                // A robot whose process ended comes back as one does that was switched off.
                if node.broken().is_some() && node.revive().is_err() {
                    return false;
                }
                node.publish(&about.topic, 0, &message)
            })
        };
        self.threads.push(repeat(name, period, &self.stopping, publish)?);
        Ok(())
    }
}

impl Drop for RosrustFleet {
    fn drop(&mut self) {
        self.stopping.store(true, Ordering::SeqCst);
        for thread in self.threads.drain(..) {
            thread.thread().unpark();
            drop(thread.join());
        }
        self.nodes.iter().for_each(|node| locked(node).leave());
        let begun = Instant::now();
        while begun.elapsed() < FAREWELL && !self.nodes.iter().all(|node| locked(node).is_sent()) {
            std::thread::sleep(Duration::from_millis(5));
        }
    }
}
