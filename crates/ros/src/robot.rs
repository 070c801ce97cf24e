//! Simulated robots with odometry and camera, each a ROS node of its own, or all of them one participant of a ROS 2
//! domain. Capture cannot distinguish them from real ones, but their records are marked as simulated.

mod picture;

use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex};
use std::time::{Duration, Instant};
use std::{f64::consts::TAU, path::Path, thread::JoinHandle};

use crate::message::{built_in_definition, md5sum};
use crate::ros2::{Declined, Offer, Offered, Ros2Publisher};
use crate::{Advertised, GraphPublisher, Publisher, Result, RosError, RosrustPublisher, lock};
use crate::{model::Timestamp, robot::picture::Camera};

pub const MOST_ROBOTS: u16 = 64;

const FASTEST: f64 = 1000.0;

const FAREWELL: Duration = Duration::from_secs(1);

#[derive(Debug, Clone, Copy, PartialEq)]
pub struct FleetOptions {
    /// Messages per second and robot.
    pub odometry_hz: f64,
    /// Pictures per second and robot.
    pub picture_hz: f64,
}

impl Default for FleetOptions {
    fn default() -> Self {
        Self { odometry_hz: 20.0, picture_hz: 2.0 }
    }
}

/// Takes what makes a message, and says whether it was published; nothing is made for a topic without subscribers.
type Sink = Box<dyn FnMut(&mut dyn FnMut() -> Option<Vec<u8>>) -> bool + Send>;

/// The threads of the robots. They end on drop.
#[derive(Default)]
struct Work {
    stopping: Arc<AtomicBool>,
    /// Each returns how many messages it published.
    threads: Vec<JoinHandle<u32>>,
}

impl Work {
    /// In CDR or as ROS 1 has it.
    fn add(
        &mut self,
        number: u16,
        periods: (Duration, Duration),
        is_cdr: bool,
        [mut odometry, mut pictures]: [Sink; 2],
    ) -> Result<()> {
        let track = Track::of_robot(number);
        self.repeat("robot-odometry", periods.0, move |seq, age| {
            odometry(&mut || Some(odometry_message(is_cdr, seq, Timestamp::now(), &track.at(age))))
        })?;
        let mut camera = Camera::new(number, track);
        self.repeat("robot-camera", periods.1, move |seq, age| {
            pictures(&mut || {
                let jpeg = camera.shoot(seq, age)?;
                Some(image_message(is_cdr, seq, Timestamp::now(), number, &jpeg))
            })
        })
    }

    /// Calls `work` with number and age (seconds) once per period, in a thread; counts the calls that return true.
    fn repeat(
        &mut self,
        name: &str,
        period: Duration,
        mut work: impl FnMut(u32, f64) -> bool + Send + 'static,
    ) -> Result<()> {
        let stopping = Arc::clone(&self.stopping);
        let work = move || {
            let begun = Instant::now();
            let mut due = begun;
            let mut seq = 0u32;
            while wait_until(due, &stopping) {
                if work(seq, begun.elapsed().as_secs_f64()) {
                    seq = seq.wrapping_add(1);
                }
                // After a suspend continue from now: no burst of missed messages.
                due = (due + period).max(Instant::now().checked_sub(period).unwrap_or(due));
            }
            seq
        };
        let thread = std::thread::Builder::new().name(name.into()).spawn(work);
        self.threads.push(thread.map_err(|error| RosError::system("start a thread", &error))?);
        Ok(())
    }

    fn end(&mut self) -> Vec<u32> {
        self.stopping.store(true, Ordering::SeqCst);
        self.threads.iter().for_each(|thread| thread.thread().unpark());
        self.threads.drain(..).map(|thread| thread.join().unwrap_or_default()).collect()
    }
}

impl Drop for Work {
    fn drop(&mut self) {
        self.end();
    }
}

/// Leaves the graph on drop; queued messages are sent first.
pub struct Fleet {
    work: Work,
    nodes: Vec<Arc<Mutex<Box<dyn GraphPublisher>>>>,
}

impl Fleet {
    pub fn start(master_uri: &str, robots: u16, options: FleetOptions) -> Result<Self> {
        Self::of(robots, options, |node| Ok(Box::new(Publisher::start(master_uri, None, node)?)))
    }

    /// The same, each in a process of its own.
    pub fn by_rosrust(master_uri: &str, program: Option<&Path>, robots: u16, options: FleetOptions) -> Result<Self> {
        Self::of(robots, options, |node| Ok(Box::new(RosrustPublisher::start(master_uri, None, node, program)?)))
    }

    fn of(robots: u16, options: FleetOptions, start: impl Fn(&str) -> Result<Box<dyn GraphPublisher>>) -> Result<Self> {
        let periods = options.periods(robots)?;
        let mut fleet = Self { work: Work::default(), nodes: Vec::new() };
        for number in 1..=robots {
            let node = Arc::new(Mutex::new(start(&format!("/robot{number}_sim"))?));
            fleet.nodes.push(Arc::clone(&node));
            let topics = topics_of(number);
            let odometry = sink(&node, topics.0, (ODOMETRY, odometry_definition()))?;
            let pictures = sink(&node, topics.1, (COMPRESSED_IMAGE, compressed_image_definition()))?;
            fleet.work.add(number, periods, false, [odometry, pictures])?;
        }
        Ok(fleet)
    }

    /// The robots' topics and their numbers of published messages, with or without subscribers: the first has
    /// `header.seq` 0.
    pub fn stop(mut self) -> Vec<(String, u64)> {
        let topics = (1..).map(topics_of).flat_map(|(odometry, pictures)| [odometry, pictures]);
        topics.zip(self.work.end().into_iter().map(u64::from)).collect()
    }
}

fn sink(
    node: &Arc<Mutex<Box<dyn GraphPublisher>>>,
    topic: String,
    (type_name, definition): (&str, String),
) -> Result<Sink> {
    let (type_name, md5sum) = (type_name.to_owned(), md5sum(type_name, &definition)?);
    let about = Advertised { topic, type_name, md5sum, definition, latching: false };
    lock(node).advertise(&about, Duration::ZERO)?;
    let node = Arc::clone(node);
    Ok(Box::new(move |message| {
        let is_heard = lock(&node).is_heard(&about.topic);
        !is_heard || message().is_some_and(|message| lock(&node).publish(&about.topic, 0, &message))
    }))
}

impl Drop for Fleet {
    fn drop(&mut self) {
        self.work.end();
        self.nodes.iter().for_each(|node| lock(node).leave());
        let begun = Instant::now();
        while begun.elapsed() < FAREWELL && !self.nodes.iter().all(|node| lock(node).is_sent()) {
            std::thread::sleep(Duration::from_millis(5));
        }
    }
}

fn topics_of(number: u16) -> (String, String) {
    (format!("/robot{number}/odom"), format!("/robot{number}/camera/compressed"))
}

impl FleetOptions {
    fn periods(self, robots: u16) -> Result<(Duration, Duration)> {
        if robots > MOST_ROBOTS {
            return Err(RosError::Robots(robots));
        }
        Ok((period(self.odometry_hz)?, period(self.picture_hz)?))
    }
}

fn period(hz: f64) -> Result<Duration> {
    let period = Duration::try_from_secs_f64(1.0 / hz).ok().filter(|_| hz > 0.0 && hz <= FASTEST);
    period.ok_or_else(|| RosError::Rate(hz.to_string()))
}

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

#[derive(Debug, Clone, Copy)]
struct Track {
    centre: (f64, f64),
    half_width: f64,
    half_height: f64,
    phase: f64,
    /// Radians of the path's parameter per second.
    pace: f64,
}

#[derive(Debug, Clone, Copy, PartialEq)]
struct Motion {
    pub x: f64,
    pub y: f64,
    /// Radians from the X axis.
    pub heading: f64,
    /// Metres per second, along the heading.
    pub speed: f64,
    /// Radians per second.
    pub turn_rate: f64,
}

impl Track {
    pub fn of_robot(number: u16) -> Self {
        let number = f64::from(number);
        Self {
            centre: (6.0 * ((number - 1.0) % 4.0), 5.0 * ((number - 1.0) / 4.0).floor()),
            half_width: 2.0 + 0.25 * (number % 3.0),
            half_height: 0.9 + 0.1 * (number % 5.0),
            phase: TAU * (number * 0.618).fract(),
            pace: TAU / (24.0 + 3.0 * (number % 4.0)),
        }
    }

    pub fn at(&self, age: f64) -> Motion {
        let angle = self.phase + self.pace * age;
        let (sin, cos) = angle.sin_cos();
        let (sin2, cos2) = (2.0 * angle).sin_cos();
        let (vx, vy) = (-self.half_width * self.pace * sin, 2.0 * self.half_height * self.pace * cos2);
        let square = self.pace * self.pace;
        let (ax, ay) = (-self.half_width * square * cos, -4.0 * self.half_height * square * sin2);
        Motion {
            x: self.centre.0 + self.half_width * cos,
            y: self.centre.1 + self.half_height * sin2,
            heading: vy.atan2(vx),
            speed: vx.hypot(vy),
            turn_rate: (vx * ay - vy * ax) / (vx * vx + vy * vy),
        }
    }
}

const USUAL: Offer = Offer { reliable: true, latched: false, depth: 10 };
const LITTLE: u16 = 1;
/// Approximate bytes.
const ODOMETRY_SIZE: usize = 720;
const PICTURE_SIZE: usize = 60_000;

pub struct DomainFleet {
    _work: Work,
}

impl DomainFleet {
    pub fn start(domain: u16, program: Option<&Path>, robots: u16, options: FleetOptions) -> Result<Self> {
        let periods = options.periods(robots)?;
        let publisher = Arc::new(Mutex::new(Ros2Publisher::start(domain, program)?));
        let sink = |name: String, type_name: &str, size: usize| -> Result<Sink> {
            let topic = Offered { name, type_name: type_name.to_owned(), encoding: LITTLE, offer: USUAL };
            let refused = |declined: Declined| RosError::NotPublished {
                domain,
                reason: format!("{}; give the robots a domain of their own, such as --ros2 42", declined.reason),
            };
            let writer = lock(&publisher).advertise(&topic, size, (true, false))?.map_err(refused)?;
            let publisher = Arc::clone(&publisher);
            Ok(Box::new(move |message| message().is_some_and(|message| lock(&publisher).publish(writer, &message))))
        };
        let mut work = Work::default();
        for number in 1..=robots {
            let topics = topics_of(number);
            let odometry = sink(topics.0, "nav_msgs/msg/Odometry", ODOMETRY_SIZE)?;
            let pictures = sink(topics.1, "sensor_msgs/msg/CompressedImage", PICTURE_SIZE)?;
            work.add(number, periods, true, [odometry, pictures])?;
        }
        Ok(Self { _work: work })
    }
}

// The robots' messages, serialised as ROS 1 does (little endian, lengths of 32 bits) and as ROS 2 does (CDR, each
// value at a multiple of its size).

/// Standard deviations squared: x, y (m²) and the rotation about Z (rad²); the rest is not measured.
const VARIANCES: [f64; 6] = [0.0004, 0.0004, 1e-6, 1e-6, 1e-6, 0.0003];

/// Only ROS 1 has a number in its headers.
fn odometry_message(is_cdr: bool, seq: u32, stamp: Timestamp, motion: &Motion) -> Vec<u8> {
    let mut message = Message::new(is_cdr, 760);
    message.put_header(seq, stamp, "odom");
    message.put_text("base_link");
    let half = motion.heading / 2.0;
    message.put_floats(&[motion.x, motion.y, 0.0, 0.0, 0.0, half.sin(), half.cos()]);
    message.put_floats(&covariance());
    message.put_floats(&[motion.speed, 0.0, 0.0, 0.0, 0.0, motion.turn_rate]);
    message.put_floats(&covariance());
    message.bytes
}

/// With format `jpeg`.
fn image_message(is_cdr: bool, seq: u32, stamp: Timestamp, robot: u16, jpeg: &[u8]) -> Vec<u8> {
    let mut message = Message::new(is_cdr, jpeg.len() + 72);
    message.put_header(seq, stamp, &format!("robot{robot}_camera"));
    message.put_text("jpeg");
    message.put_length(jpeg.len());
    message.bytes.extend_from_slice(jpeg);
    message.bytes
}

fn covariance() -> [f64; 36] {
    let mut matrix = [0.0; 36];
    for (place, variance) in matrix.iter_mut().step_by(7).zip(VARIANCES) {
        *place = variance;
    }
    matrix
}

pub const ODOMETRY: &str = "nav_msgs/Odometry";

pub const COMPRESSED_IMAGE: &str = "sensor_msgs/CompressedImage";

pub fn odometry_definition() -> String {
    built_in_definition(ODOMETRY, "cd5e73d190d741a2f92e81eda573aca7").unwrap_or_default()
}

pub fn compressed_image_definition() -> String {
    built_in_definition(COMPRESSED_IMAGE, "8f7a12909da2c9d3332d540a0977563f").unwrap_or_default()
}

/// CDR, little endian, without options.
const ENCAPSULATION: [u8; 4] = [0, 1, 0, 0];

struct Message {
    is_cdr: bool,
    bytes: Vec<u8>,
}

impl Message {
    fn new(is_cdr: bool, room: usize) -> Self {
        let mut bytes = Vec::with_capacity(room);
        bytes.extend_from_slice(if is_cdr { &ENCAPSULATION } else { &[] });
        Self { is_cdr, bytes }
    }

    /// Counted from behind the encapsulation header.
    fn align(&mut self, size: usize) {
        if self.is_cdr {
            let place = self.bytes.len() - ENCAPSULATION.len();
            self.bytes.resize(ENCAPSULATION.len() + place.next_multiple_of(size), 0);
        }
    }

    fn put_number(&mut self, number: u32) {
        self.align(4);
        self.bytes.extend_from_slice(&number.to_le_bytes());
    }

    fn put_length(&mut self, length: usize) {
        self.put_number(u32::try_from(length).unwrap_or(u32::MAX));
    }

    fn put_header(&mut self, seq: u32, stamp: Timestamp, frame: &str) {
        if !self.is_cdr {
            self.put_number(seq);
        }
        self.put_number(u32::try_from(stamp.seconds()).unwrap_or(u32::MAX));
        self.put_number(u32::try_from(stamp.0 % 1_000_000_000).unwrap_or(0));
        self.put_text(frame);
    }

    /// In CDR a zero ends a text and counts.
    fn put_text(&mut self, text: &str) {
        let end: &[u8] = if self.is_cdr { &[0] } else { &[] };
        self.put_length(text.len() + end.len());
        self.bytes.extend_from_slice(text.as_bytes());
        self.bytes.extend_from_slice(end);
    }

    fn put_floats(&mut self, numbers: &[f64]) {
        self.align(8);
        numbers.iter().for_each(|number| self.bytes.extend_from_slice(&number.to_le_bytes()));
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_twist_is_the_derivative_of_the_pose_and_the_path_closes() {
        let step = 1e-5;
        for number in 1..=8 {
            let track = Track::of_robot(number);
            for tenth in 0..400 {
                let age = f64::from(tenth) / 10.0;
                let (before, now, after) = (track.at(age - step), track.at(age), track.at(age + step));
                let (vx, vy) = ((after.x - before.x) / (2.0 * step), (after.y - before.y) / (2.0 * step));
                assert!((vx - now.speed * now.heading.cos()).abs() < 1e-6);
                assert!((vy - now.speed * now.heading.sin()).abs() < 1e-6);
                let turned = (after.heading - before.heading + TAU / 2.0).rem_euclid(TAU) - TAU / 2.0;
                assert!((turned / (2.0 * step) - now.turn_rate).abs() < 1e-4);
                assert!(now.speed > 0.05);
            }
            let round = track.at(TAU / track.pace);
            assert!((round.x - track.at(0.0).x).abs() < 1e-9 && (round.y - track.at(0.0).y).abs() < 1e-9);
        }
    }
}

#[cfg(test)]
mod messages_tests {
    use super::*;
    use crate::ros::robot::Track;
    use crate::ros::{Definition, Limits, Value};

    #[test]
    fn odometry_decodes_to_what_was_put_in() {
        let definition = Definition::parse(ODOMETRY, &odometry_definition()).expect("definition");
        let motion = Track::of_robot(2).at(3.0);
        let body = odometry_message(false, 41, Timestamp(1_700_000_000_000_000_007), &motion);
        let value = definition.decode(&body, Limits::default()).expect("fits");
        assert_eq!(value.get("header.seq"), Some(&Value::Unsigned(41)));
        assert_eq!(value.get("header.stamp"), Some(&Value::Time(1_700_000_000, 7)));
        assert_eq!(value.get("header.frame_id"), Some(&Value::Text("odom".into())));
        assert_eq!(value.get("child_frame_id"), Some(&Value::Text("base_link".into())));
        assert_eq!(value.get("pose.pose.position.x"), Some(&Value::Float(motion.x)));
        assert_eq!(value.get("twist.twist.linear.x"), Some(&Value::Float(motion.speed)));
        let Some(Value::Array(covariance)) = value.get("twist.covariance") else { panic!("covariance") };
        assert_eq!((covariance.len(), &covariance[35]), (36, &Value::Float(VARIANCES[5])));
    }

    #[test]
    fn a_picture_comes_back_byte_for_byte() {
        let definition = Definition::parse(COMPRESSED_IMAGE, &compressed_image_definition()).expect("definition");
        let jpeg: Vec<u8> = (0..=255).cycle().take(5000).collect();
        let body = image_message(false, 3, Timestamp(9), 1, &jpeg);
        let picture = definition.compressed_image(&body).expect("picture");
        assert_eq!((picture.format.as_str(), &body[picture.data]), ("jpeg", jpeg.as_slice()));
        assert_eq!(definition.compressed_image(&body[..body.len() - 1]), None);
    }
}

#[cfg(test)]
mod definitions_tests {
    use super::*;
    use crate::ros::message::md5sum;

    #[test]
    fn the_md5sums_are_those_of_ros() {
        assert_eq!(md5sum(ODOMETRY, &odometry_definition()).as_deref(), Ok("cd5e73d190d741a2f92e81eda573aca7"));
        let sum = md5sum(COMPRESSED_IMAGE, &compressed_image_definition());
        assert_eq!(sum.as_deref(), Ok("8f7a12909da2c9d3332d540a0977563f"));
    }
}

#[cfg(test)]
mod cdr_tests {
    use super::*;
    use crate::ros::message::Folders;
    use crate::ros::robot::Track;
    use crate::ros::{Definition, Limits, Value};

    /// The built-in definition, which is held to rosbags' by hash and by decoded values.
    fn definition(type_name: &str) -> Definition {
        let (text, _) = Folders::default().text_of(type_name).expect("built in");
        Definition::parse_ros2(type_name, &text).expect("a definition")
    }

    #[test]
    fn odometry_decodes_to_what_was_put_in() {
        let motion = Track::of_robot(2).at(3.0);
        let message = odometry_message(true, 41, Timestamp(1_700_000_000_000_000_007), &motion);
        let value = definition("nav_msgs/msg/Odometry").decode(&message, Limits::default()).expect("fits");
        assert_eq!(value.get("header.frame_id"), Some(&Value::Text("odom".into())));
        assert_eq!(value.get("child_frame_id"), Some(&Value::Text("base_link".into())));
        assert_eq!(value.get("pose.pose.position.x"), Some(&Value::Float(motion.x)));
        assert_eq!(value.get("twist.twist.angular.z"), Some(&Value::Float(motion.turn_rate)));
        let Some(Value::Array(covariance)) = value.get("twist.covariance") else { panic!("covariance") };
        assert_eq!((covariance.len(), &covariance[0]), (36, &Value::Float(0.0004)));
    }

    #[test]
    fn a_picture_comes_back_byte_for_byte() {
        let jpeg: Vec<u8> = (0..=255).cycle().take(5001).collect();
        let message = image_message(true, 3, Timestamp(9), 1, &jpeg);
        let definition = definition("sensor_msgs/msg/CompressedImage");
        let picture = definition.compressed_image(&message).expect("a picture");
        assert_eq!((picture.format.as_str(), &message[picture.data]), ("jpeg", jpeg.as_slice()));
    }
}
