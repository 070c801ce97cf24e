//! The same robots in a ROS 2 domain: one participant, which the program that speaks ROS 2 runs, with the topics of all.

use std::path::Path;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex, PoisonError};
use std::thread::JoinHandle;
use std::time::Duration;

use super::picture::Camera;
use super::track::Track;
use super::{FleetOptions, MOST_ROBOTS, cdr, period, repeat};
use crate::model::Timestamp;
use crate::ros::RosError;
use crate::ros::ros2::{Declined, Offer, Offered, Ros2Publisher};

/// What a node of ROS 2 offers if it is not told otherwise.
const USUAL: Offer = Offer { reliable: true, latched: false, depth: 10 };
/// CDR, little-endian.
const LITTLE: u16 = 1;
/// About how long a message is, bytes.
const ODOMETRY_SIZE: usize = 720;
const PICTURE_SIZE: usize = 60_000;

/// Running robots of ROS 2. They leave the domain on drop.
pub struct DomainFleet {
    publisher: Arc<Mutex<Ros2Publisher>>,
    stopping: Arc<AtomicBool>,
    threads: Vec<JoinHandle<()>>,
}

impl DomainFleet {
    /// Starts `robots` robots, numbered from 1, in `domain`; `program` names the program that publishes if it is not beside
    /// this one. A domain in which somebody else publishes their topics is left alone.
    ///
    /// # Errors
    /// [`RosError::Robots`] beyond [`MOST_ROBOTS`], [`RosError::Rate`] for an invalid rate, [`RosError::NoReader`] if that
    /// program is missing, [`RosError::NotPublished`] if it cannot publish there.
    pub fn start(domain: u16, program: Option<&Path>, robots: u16, options: FleetOptions) -> Result<Self, RosError> {
        if robots > MOST_ROBOTS {
            return Err(RosError::Robots(robots));
        }
        let periods = (period(options.odometry_hz)?, period(options.picture_hz)?);
        let publisher = Arc::new(Mutex::new(Ros2Publisher::start(domain, program)?));
        let mut fleet = Self { publisher, stopping: Arc::default(), threads: Vec::new() };
        for number in 1..=robots {
            fleet.add(domain, number, periods)?;
        }
        Ok(fleet)
    }

    fn add(&mut self, domain: u16, number: u16, periods: (Duration, Duration)) -> Result<(), RosError> {
        let odometry = self.announce(domain, format!("/robot{number}/odom"), "nav_msgs/msg/Odometry", ODOMETRY_SIZE)?;
        let name = format!("/robot{number}/camera/compressed");
        let pictures = self.announce(domain, name, "sensor_msgs/msg/CompressedImage", PICTURE_SIZE)?;
        let track = Track::of_robot(number);
        self.publish("robot-odometry", odometry, periods.0, move |_, age| {
            Some(cdr::odometry(Timestamp::now(), &track.at(age)))
        })?;
        let mut camera = Camera::new(number, track);
        self.publish("robot-camera", pictures, periods.1, move |seq, age| {
            camera.shoot(seq, age).map(|jpeg| cdr::compressed_image(Timestamp::now(), number, &jpeg))
        })
    }

    fn announce(&self, domain: u16, name: String, type_name: &str, size: usize) -> Result<u32, RosError> {
        let topic = Offered { name, type_name: type_name.to_owned(), encoding: LITTLE, offer: USUAL };
        let mut publisher = self.publisher.lock().unwrap_or_else(PoisonError::into_inner);
        let refused = |declined: Declined| RosError::NotPublished {
            domain,
            reason: format!("{}; choose a domain of their own for the robots, as --ros2 42", declined.reason),
        };
        publisher.advertise(&topic, size, (true, false))?.map_err(refused)
    }

    fn publish(
        &mut self,
        name: &str,
        writer: u32,
        period: Duration,
        mut make: impl FnMut(u32, f64) -> Option<Vec<u8>> + Send + 'static,
    ) -> Result<(), RosError> {
        let publisher = Arc::clone(&self.publisher);
        let publish = move |seq, age| {
            let message = make(seq, age);
            message.is_some_and(|message| {
                publisher.lock().unwrap_or_else(PoisonError::into_inner).publish(writer, &message)
            })
        };
        self.threads.push(repeat(name, period, &self.stopping, publish)?);
        Ok(())
    }
}

impl Drop for DomainFleet {
    fn drop(&mut self) {
        self.stopping.store(true, Ordering::SeqCst);
        for thread in self.threads.drain(..) {
            thread.thread().unpark();
            drop(thread.join());
        }
    }
}
