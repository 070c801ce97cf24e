//! The robots' messages as ROS 2 serialises them: CDR, little-endian, each value at a multiple of its size.

use super::messages::covariance;
use super::track::Motion;
use crate::model::Timestamp;

/// The encapsulation header of CDR in this order of bytes, without options.
const HEADER: [u8; 4] = [0, 1, 0, 0];

/// A `nav_msgs/msg/Odometry`.
pub(super) fn odometry(stamp: Timestamp, motion: &Motion) -> Vec<u8> {
    let mut message = Message::new(760);
    message.put_header(stamp, "odom");
    message.put_text("base_link");
    let half = motion.heading / 2.0;
    message.put_floats(&[motion.x, motion.y, 0.0, 0.0, 0.0, half.sin(), half.cos()]);
    message.put_floats(&covariance());
    message.put_floats(&[motion.speed, 0.0, 0.0, 0.0, 0.0, motion.turn_rate]);
    message.put_floats(&covariance());
    message.0
}

/// A `sensor_msgs/msg/CompressedImage` with format `jpeg`.
pub(super) fn compressed_image(stamp: Timestamp, robot: u16, jpeg: &[u8]) -> Vec<u8> {
    let mut message = Message::new(jpeg.len() + 72);
    message.put_header(stamp, &format!("robot{robot}_camera"));
    message.put_text("jpeg");
    message.put_length(jpeg.len());
    message.0.extend_from_slice(jpeg);
    message.0
}

struct Message(Vec<u8>);

impl Message {
    fn new(room: usize) -> Self {
        let mut bytes = Vec::with_capacity(room);
        bytes.extend_from_slice(&HEADER);
        Self(bytes)
    }

    /// Places are counted from behind the encapsulation header.
    fn align(&mut self, size: usize) {
        let place = self.0.len() - HEADER.len();
        self.0.resize(HEADER.len() + place.next_multiple_of(size), 0);
    }

    fn put_number(&mut self, number: u32) {
        self.align(4);
        self.0.extend_from_slice(&number.to_le_bytes());
    }

    fn put_length(&mut self, length: usize) {
        self.put_number(u32::try_from(length).unwrap_or(u32::MAX));
    }

    fn put_header(&mut self, stamp: Timestamp, frame: &str) {
        self.put_number(u32::try_from(stamp.seconds()).unwrap_or(u32::MAX));
        self.put_number(u32::try_from(stamp.0 % 1_000_000_000).unwrap_or(0));
        self.put_text(frame);
    }

    fn put_text(&mut self, text: &str) {
        self.put_length(text.len() + 1);
        self.0.extend_from_slice(text.as_bytes());
        self.0.push(0);
    }

    fn put_floats(&mut self, numbers: &[f64]) {
        self.align(8);
        numbers.iter().for_each(|number| self.0.extend_from_slice(&number.to_le_bytes()));
    }
}

#[cfg(test)]
mod tests {
    use super::super::track::Track;
    use super::*;
    use crate::ros::message::Folders;
    use crate::ros::{Definition, Limits, Value};

    /// The built-in definition, which is held to rosbags' by hash and by decoded values.
    fn definition(type_name: &str) -> Definition {
        let (text, _) = Folders::default().text_of(type_name).expect("built in");
        Definition::parse_ros2(type_name, &text).expect("a definition")
    }

    #[test]
    fn odometry_decodes_to_what_was_put_in() {
        let motion = Track::of_robot(2).at(3.0);
        let message = odometry(Timestamp(1_700_000_000_000_000_007), &motion);
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
        let message = compressed_image(Timestamp(9), 1, &jpeg);
        let definition = definition("sensor_msgs/msg/CompressedImage");
        let picture = definition.compressed_image(&message).expect("a picture");
        assert_eq!((picture.format.as_str(), &message[picture.data]), ("jpeg", jpeg.as_slice()));
    }
}
