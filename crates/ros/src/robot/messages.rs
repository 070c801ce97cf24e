//! The robots' messages, serialised as ROS does: little endian, lengths of 32 bits.

use super::track::Motion;
use crate::model::Timestamp;

/// Standard deviations squared: x, y (m²) and the rotation about Z (rad²); the rest is not measured.
const VARIANCES: [f64; 6] = [0.0004, 0.0004, 1e-6, 1e-6, 1e-6, 0.0003];

/// The body of a `nav_msgs/Odometry`.
pub(super) fn odometry(seq: u32, stamp: Timestamp, motion: &Motion) -> Vec<u8> {
    let mut body = Vec::with_capacity(724);
    put_header(&mut body, seq, stamp, "odom");
    put_text(&mut body, "base_link");
    let half = motion.heading / 2.0;
    put_floats(&mut body, &[motion.x, motion.y, 0.0, 0.0, 0.0, half.sin(), half.cos()]);
    put_floats(&mut body, &covariance());
    put_floats(&mut body, &[motion.speed, 0.0, 0.0, 0.0, 0.0, motion.turn_rate]);
    put_floats(&mut body, &covariance());
    body
}

/// The body of a `sensor_msgs/CompressedImage` with format `jpeg`.
pub(super) fn compressed_image(seq: u32, stamp: Timestamp, robot: u16, jpeg: &[u8]) -> Vec<u8> {
    let mut body = Vec::with_capacity(jpeg.len() + 64);
    put_header(&mut body, seq, stamp, &format!("robot{robot}_camera"));
    put_text(&mut body, "jpeg");
    put_bytes(&mut body, jpeg);
    body
}

fn put_header(body: &mut Vec<u8>, seq: u32, stamp: Timestamp, frame: &str) {
    let seconds = u32::try_from(stamp.seconds()).unwrap_or(u32::MAX);
    let nanoseconds = u32::try_from(stamp.0 % 1_000_000_000).unwrap_or(0);
    for number in [seq, seconds, nanoseconds] {
        body.extend_from_slice(&number.to_le_bytes());
    }
    put_text(body, frame);
}

fn put_text(body: &mut Vec<u8>, text: &str) {
    put_bytes(body, text.as_bytes());
}

fn put_bytes(body: &mut Vec<u8>, bytes: &[u8]) {
    body.extend_from_slice(&u32::try_from(bytes.len()).unwrap_or(u32::MAX).to_le_bytes());
    body.extend_from_slice(bytes);
}

fn put_floats(body: &mut Vec<u8>, numbers: &[f64]) {
    for number in numbers {
        body.extend_from_slice(&number.to_le_bytes());
    }
}

/// The matrix of both messages' uncertainty.
pub(super) fn covariance() -> [f64; 36] {
    let mut matrix = [0.0; 36];
    for (place, variance) in matrix.iter_mut().step_by(7).zip(VARIANCES) {
        *place = variance;
    }
    matrix
}

#[cfg(test)]
mod tests {
    use super::super::definitions::*;
    use super::super::track::Track;
    use super::*;
    use crate::ros::{Definition, Limits, Value};

    #[test]
    fn odometry_decodes_to_what_was_put_in() {
        let definition = Definition::parse(ODOMETRY, &odometry_definition()).expect("definition");
        let motion = Track::of_robot(2).at(3.0);
        let body = odometry(41, Timestamp(1_700_000_000_000_000_007), &motion);
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
        let body = compressed_image(3, Timestamp(9), 1, &jpeg);
        let picture = definition.compressed_image(&body).expect("picture");
        assert_eq!((picture.format.as_str(), &body[picture.data]), ("jpeg", jpeg.as_slice()));
        assert_eq!(definition.compressed_image(&body[..body.len() - 1]), None);
    }
}
