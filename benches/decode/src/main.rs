//! Decoding of a message with a body of 1 MB by AuthROS, by rosrust's DynamicMsg and by rospy, in one run:
//! `cargo run --release --manifest-path benches/decode/Cargo.toml`. The decoder is the product's own crate.

use std::hint::black_box;
use std::process::{Command, ExitCode};
use std::time::Instant;

use authros_ros::message::{Definition, Limits};

const TYPE: &str = "sensor_msgs/Image";
const OWN: &str = "Header header\nuint32 height\nuint32 width\nstring encoding\nuint8 is_bigendian\nuint32 step\nuint8[] data";
const HEADER: &str = "uint32 seq\ntime stamp\nstring frame_id";
/// rospy's part, with its own timing: microseconds of one decoding, the median.
const ROSPY: &str = "import sys,time,statistics\nfrom sensor_msgs.msg import Image\nb=open(sys.argv[1],'rb').read()\nt=[]\n\
    for _ in range(200):\n s=time.perf_counter();m=Image();m.deserialize(b);t.append(time.perf_counter()-s)\n\
    assert len(m.data)==1000000\nprint(statistics.median(t)*1e6)";

/// A picture of 1000 x 1000 greys.
fn body() -> Vec<u8> {
    let mut body = vec![0; 12];
    body.extend([3, 0, 0, 0]);
    body.extend(b"cam");
    body.extend([1000u32.to_le_bytes(), 1000u32.to_le_bytes()].concat());
    body.extend([5, 0, 0, 0]);
    body.extend(b"mono8");
    body.push(0);
    body.extend(1000u32.to_le_bytes());
    body.extend(1_000_000u32.to_le_bytes());
    body.extend((0..=250u8).cycle().take(1_000_000));
    body
}

/// The median of several rounds, microseconds.
fn median(rounds: usize, mut work: impl FnMut()) -> f64 {
    let mut times: Vec<f64> = (0..rounds)
        .map(|_| {
            let begun = Instant::now();
            work();
            begun.elapsed().as_secs_f64() * 1e6
        })
        .collect();
    times.sort_by(f64::total_cmp);
    times[times.len() / 2]
}

fn rospy(body: &[u8]) -> Option<f64> {
    let path = std::env::temp_dir().join(format!("decode-bench-{}", std::process::id()));
    std::fs::write(&path, body).ok()?;
    let output = Command::new("/usr/bin/python3").args(["-c", ROSPY]).arg(&path).output();
    drop(std::fs::remove_file(&path));
    String::from_utf8(output.ok()?.stdout).ok()?.trim().parse().ok()
}

fn main() -> ExitCode {
    let body = body();
    let text = format!("{OWN}\n{}\nMSG: std_msgs/Header\n{HEADER}", "=".repeat(80));
    let ours = Definition::parse(TYPE, &text).expect("a definition");
    let theirs = rosrust::DynamicMsg::new(TYPE, &text).expect("a definition");
    let view = median(2000, || drop(black_box(ours.decode(black_box(&body), Limits::default()).expect("fits"))));
    let json = median(20, || {
        let mut out = Vec::with_capacity(4 << 20);
        ours.write_json(black_box(&body), &mut out).expect("fits");
        drop(black_box(out));
    });
    let dynamic = median(20, || drop(black_box(theirs.decode(black_box(&body[..])).expect("fits"))));
    println!("sensor_msgs/Image with 1,000,000 bytes of data, microseconds (median)");
    println!("  AuthROS, for display   {view:>12.2}");
    println!("  AuthROS, whole as JSON {json:>12.2}");
    println!("  rosrust DynamicMsg     {dynamic:>12.2}");
    match rospy(&body) {
        Some(time) => println!("  rospy                  {time:>12.2}"),
        None => println!("  rospy                       absent (no sensor_msgs for /usr/bin/python3)"),
    }
    println!("AuthROS for display is {:.0} times as fast as DynamicMsg (wanted: 100)", dynamic / view);
    if dynamic >= 100.0 * view { ExitCode::SUCCESS } else { ExitCode::FAILURE }
}
