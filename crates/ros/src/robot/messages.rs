//! The robots' messages, serialised as ROS 1 does (little endian, lengths of 32 bits) and as ROS 2 does (CDR, each
//! value at a multiple of its size).

use super::Motion;
use crate::model::Timestamp;
use crate::ros::message::built_in_definition;

/// Standard deviations squared: x, y (m²) and the rotation about Z (rad²); the rest is not measured.
const VARIANCES: [f64; 6] = [0.0004, 0.0004, 1e-6, 1e-6, 1e-6, 0.0003];

/// Only ROS 1 has a number in its headers.
pub(super) fn odometry(is_cdr: bool, seq: u32, stamp: Timestamp, motion: &Motion) -> Vec<u8> {
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
pub(super) fn compressed_image(is_cdr: bool, seq: u32, stamp: Timestamp, robot: u16, jpeg: &[u8]) -> Vec<u8> {
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
    use crate::ros::robot::Track;
    use crate::ros::{Definition, Limits, Value};

    #[test]
    fn odometry_decodes_to_what_was_put_in() {
        let definition = Definition::parse(ODOMETRY, &odometry_definition()).expect("definition");
        let motion = Track::of_robot(2).at(3.0);
        let body = odometry(false, 41, Timestamp(1_700_000_000_000_000_007), &motion);
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
        let body = compressed_image(false, 3, Timestamp(9), 1, &jpeg);
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
        let message = odometry(true, 41, Timestamp(1_700_000_000_000_000_007), &motion);
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
        let message = compressed_image(true, 3, Timestamp(9), 1, &jpeg);
        let definition = definition("sensor_msgs/msg/CompressedImage");
        let picture = definition.compressed_image(&message).expect("a picture");
        assert_eq!((picture.format.as_str(), &message[picture.data]), ("jpeg", jpeg.as_slice()));
    }
}
