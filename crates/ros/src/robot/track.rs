//! The robots' paths: closed, smooth figures of eight on the ground, each robot with its own size, place and phase.

use std::f64::consts::TAU;

/// A robot's path and pace.
#[derive(Debug, Clone, Copy)]
pub(super) struct Track {
    centre: (f64, f64),
    half_width: f64,
    half_height: f64,
    phase: f64,
    /// Radians of the path's parameter per second.
    pace: f64,
}

/// Where a robot is on the ground and how it moves.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Motion {
    /// Metres.
    pub x: f64,
    /// Metres.
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

    /// The motion `age` seconds after the start.
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
