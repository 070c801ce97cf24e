//! Messages of any type: decoded as by ROS's own Python, compressed and restored to the byte, viewed and exported;
//! hostile ones within limits.
#![allow(clippy::print_stdout, reason = "figures that the run shows")]
#![allow(clippy::expect_used, clippy::panic, reason = "a test fails by panicking")]

use crate::support;

use std::fs;
use std::path::Path;
use std::process::Command;

use authros::model::bytes::unhex;
use authros::ros::readable::{Exported, export, read};
use authros::ros::{Definition, Limits};
use base64::Engine as _;
use base64::engine::general_purpose::STANDARD;
use serde_json::Value;
use support::process::Running;
use support::{
    Authros, Console, Home, Roscore, count, heavy, holds, long, robot_recording, shared_data, skipped, system_program,
    text,
};
use zune_jpeg::zune_core::bytestream::ZCursor;

const NO_ROS: &str = "no roscore, rosbag and rostopic in /usr/bin";
const CAMERA: &str = "/robot1/camera/compressed";
const MEBIBYTE: u64 = 1 << 20;

/// The output of `rospy_messages.py`.
fn rospy(arguments: &[&str]) -> String {
    let mut command = Command::new("/usr/bin/python3");
    command.env("PATH", "/usr/bin:/bin").env_remove("PYTHONPATH");
    command.arg(concat!(env!("CARGO_MANIFEST_DIR"), "/tests/support/rospy_messages.py")).args(arguments);
    Running::start(command).wait(180).expect_code(0).stdout
}

/// Our JSON of every message of `made`, compared with rospy's decoding; returns how many messages and types that were.
fn compared(home: &Home, made: &str) -> (u64, u64) {
    let mut ours = Vec::new();
    for line in made.lines() {
        let record: Value = serde_json::from_str(line).expect("JSON");
        let definition = Definition::parse(&text(&record, "type"), &text(&record, "definition")).expect("definition");
        assert_eq!(definition.md5sum(), text(&record, "md5"), "{}", record["type"]);
        let body = unhex(&text(&record, "body")).expect("hex");
        definition.write_json(&body, &mut ours).expect("fits");
        ours.push(b'\n');
        for end in (0..body.len()).step_by(body.len() / 20 + 1) {
            assert!(definition.decode(&body[..end], Limits::default()).is_err(), "cut at {end}: {}", record["type"]);
            assert!(read(&definition, &body[..end]).is_none() && definition.matrix(&body[..end]).is_none());
        }
    }
    let (made, ours) = (home.file("made", made, 0o600), home.file("ours", ours, 0o600));
    let result: Value = serde_json::from_str(&rospy(&["compare", &made, &ours])).expect("JSON");
    (count(&result, "messages"), count(&result, "types"))
}

#[test]
fn every_type_is_decoded_as_rospy_does() {
    let Some(_) = system_program("rosbag") else { skipped!(NO_ROS) };
    let (messages, types) = compared(&Home::new(), &rospy(&["make"]));
    assert!(types >= 90 && messages == 4 * types, "{messages} messages of {types} types");
}

#[test]
fn every_message_of_a_recorded_robot_is_decoded_as_rospy_does() {
    let Some(made) = robot_recording() else { skipped!(NO_ROS) };
    // A recording of a real robot is kept beside the developers' checkouts; it is an extra.
    for bag in [Some(made), shared_data("jackal.bag")].into_iter().flatten() {
        let made = rospy(&["bag", bag.to_str().expect("UTF-8")]);
        assert_eq!(compared(&Home::new(), &made), (6121, 2));
    }
}

/// What a profile writes of a record under a name.
fn written(authros: &Authros, home: &Home, id: &str, name: &str) -> Vec<u8> {
    let path = home.root().join(name);
    let opened = authros.json(&["records", "open", id, "--out", path.to_str().expect("UTF-8")]);
    assert_eq!(opened["verdict"], "verified", "{opened}");
    fs::read(path).expect("written")
}

#[test]
fn a_picture_taken_at_the_robot_is_restored_and_seen_by_the_grantee() {
    let home = Home::new();
    let passphrase = home.file("passphrase", "bob's own passphrase", 0o600);
    let site = home.authros().with(&["--robots", "1"]).serve(&home);
    let alice = home.profile("alice");
    let bob = home.profile("bob").with(&["--passphrase-file", &passphrase]);
    alice.enrol();
    let address = bob.enrol();
    alice.json(&["grant", "add", &address]);
    alice.capture(&[CAMERA], 1);
    alice.capture(&["/robot1/odom"], 30);
    let id = |topic: &str| {
        text(bob.records(&["received", "list", "--oldest", "--topic", topic]).last().expect("a record"), "id")
    };
    let (picture, odometry) = (id(CAMERA), id("/robot1/odom"));

    let (body, jpeg) = (written(&alice, &home, &picture, "a.bin"), written(&bob, &home, &picture, "b.jpg"));
    assert_eq!(body, written(&bob, &home, &picture, "b.bin"));
    assert!(body.ends_with(&jpeg) && jpeg.starts_with(&[0xff, 0xd8]), "the camera's own file");
    let png = rgb_of_png(&written(&bob, &home, &picture, "b.png"));
    let decoded = zune_jpeg::JpegDecoder::new(ZCursor::new(&jpeg)).decode().expect("JPEG");
    assert!(decoded == png && png.len() == 640 * 480 * 3, "the camera's very pixels");
    expect_as_rospy(&home, &bob, [(&picture, "sensor_msgs/CompressedImage"), (&odometry, "nav_msgs/Odometry")]);

    let opened = bob.json(&["records", "open", &odometry]);
    assert_eq!((&opened["compression"], count(&opened, "bytes") > count(&opened, "stored")), (&"lz4".into(), true));
    let readable = bob.run(&["records", "open", &odometry]).expect_code(0).stdout;
    for word in ["Linear velocity, m/s", "Angular velocity, rad/s", "Pose, m", "Pose covariance", "Stamp", "Type"] {
        assert!(readable.contains(word), "{word}:\n{readable}");
    }
    let path = bob.json(&["records", "path", &odometry]);
    assert_eq!((count(&path, "records"), path["plot"]["points"].as_array().map(Vec::len)), (30, Some(30)), "{path}");
    expect_seen(&bob.with_variable("COLORTERM", "truecolor"));
    expect_seen_by_kitty(&bob, &png);
    expect_seen_as_sixel(&bob);
    site.stop("TERM", 60);
}

/// The bytes of each record, decoded by rospy, equal the JSON written for it.
fn expect_as_rospy(home: &Home, reader: &Authros, records: [(&String, &str); 2]) {
    if system_program("rosbag").is_none() {
        return;
    }
    let (mut made, mut ours) = (String::new(), Vec::new());
    for (id, name) in records {
        let body = support::hex(&written(reader, home, id, "one.bin"));
        made.push_str(&serde_json::json!({ "type": name, "body": body }).to_string());
        made.push('\n');
        ours.extend(written(reader, home, id, "one.json"));
        ours.push(b'\n');
    }
    let (made, ours) = (home.file("made", made, 0o600), home.file("ours", ours, 0o600));
    assert!(rospy(&["compare", &made, &ours]).contains("\"messages\": 2"));
}

/// A console in which the picture has just been opened.
fn picture_opened(reader: &Authros) -> Console {
    let mut console = Console::open(reader);
    console.wait_for("Overview", 30);
    console.press("4");
    console.wait_for("verified", 30);
    open_picture(&mut console);
    console
}

/// Its filter may be that of the last console, or gone.
fn open_picture(console: &mut Console) {
    console.press("/");
    console.press("\u{15}camera\r");
    support::wait_until(30, "the filter leaves the picture", || {
        let shown = console.shown();
        (shown.contains(CAMERA) && !shown.contains("/robot1/odom ")).then_some(())
    });
    opened(console, " Picture ");
}

/// Opens the record at the cursor; a key for a row is given up after some seconds without rows.
fn opened(console: &mut Console, text: &str) {
    support::wait_until(60, text, || {
        console.press("o");
        support::poll(5, || console.shown().contains(text).then_some(()))
    });
}

/// Waits until this many complete pictures have come, each between `begin` and `end`; returns the last one and what is
/// before and after it.
fn pictures(console: &Console, begin: &str, end: &str, count: usize) -> [Vec<u8>; 3] {
    let find = |hay: &[u8], needle: &str| hay.windows(needle.len()).position(|window| window == needle.as_bytes());
    support::wait_until(60, &format!("picture {count}"), || {
        let (mut before, mut rest, mut found) = (Vec::new(), console.raw(), Vec::new());
        for _ in 0..count {
            before.extend_from_slice(&found);
            let at = find(&rest, begin)?;
            let length = find(&rest[at..], end)? + end.len();
            before.extend(rest.drain(..at));
            found = rest.drain(..length).collect();
        }
        assert_eq!(find(&rest, begin), None, "more than {count} pictures");
        Some([before, found, rest])
    })
}

/// The pixels of a PNG of 8-bit RGB.
fn rgb_of_png(file: &[u8]) -> Vec<u8> {
    let mut reader = png::Decoder::new(std::io::Cursor::new(file)).read_info().expect("PNG");
    assert_eq!(reader.output_color_type(), (png::ColorType::Rgb, png::BitDepth::Eight));
    let mut pixels = vec![0; reader.output_buffer_size().expect("fits")];
    reader.next_frame(&mut pixels).expect("a whole picture");
    pixels
}

const KITTY: [&str; 2] = ["\u{1b}_Ga=T,", "\u{1b}\\\u{1b}8"];
const KITTY_AWAY: &[u8] = b"\x1b_Ga=d,d=I,i=1096111176,q=2\x1b\\";

/// The grantee's console sends the picture to a terminal that supports kitty's commands: once, and removed when it is
/// closed.
fn expect_seen_by_kitty(reader: &Authros, picture: &[u8]) {
    let reader = reader.with_variable("AUTHROS_PICTURES", "kitty");
    let mut console = picture_opened(&reader);
    let [_, put, _] = pictures(&console, KITTY[0], KITTY[1], 1);
    let put = String::from_utf8(put).expect("ASCII");
    let data: String = put.split("\u{1b}_G").filter_map(|piece| Some(piece.split_once(';')?.1)).collect();
    let data = data.replace("\u{1b}\\", "").replace("\u{1b}8", "");
    let pixel = |x: usize, y: usize| {
        let at = (y * 640 + x) * 3;
        [picture[at], picture[at + 1], picture[at + 2]]
    };
    let small = authros::ros::readable::Raster::of((640, 480), (240, 160), &pixel);
    assert!(put.contains(&format!(",s={},v={},", small.width, small.height)), "{}", &put[..90]);
    assert!(STANDARD.decode(data).expect("base64") == small.rgb, "the camera's very pixels");
    assert!(!console.shown().contains('▀'));

    console.press("y");
    console.wait_for("sent to the terminal", 30);
    assert!(!holds(&pictures(&console, KITTY[0], KITTY[1], 1)[2], KITTY_AWAY), "not with the next frame");
    console.resize(40, 120);
    let [before, ..] = pictures(&console, KITTY[0], KITTY[1], 2);
    assert!(holds(&before, KITTY_AWAY), "the one of the old size is taken away");
    support::wait_until(30, "the picture is taken away", || {
        console.press("\u{1b}");
        holds(&pictures(&console, KITTY[0], KITTY[1], 2)[2], KITTY_AWAY).then_some(())
    });
    open_picture(&mut console);
    pictures(&console, KITTY[0], KITTY[1], 3);
    console.signal("TERM");
    assert_eq!(console.wait(30).exit_code(), 143);
    console.expect_restored();
    assert!(holds(&pictures(&console, KITTY[0], KITTY[1], 3)[2], KITTY_AWAY), "nothing is left behind");
}

/// The same for sixel graphics: the cells it covered are rewritten.
fn expect_seen_as_sixel(reader: &Authros) {
    let reader = reader.with_variable("AUTHROS_PICTURES", "sixel");
    let mut console = picture_opened(&reader);
    let [before, put, _] = pictures(&console, "\u{1b}P0;1q\"1;1;", "\u{1b}\\\u{1b}8", 1);
    let before = String::from_utf8_lossy(&before).into_owned();
    let put = String::from_utf8(put).expect("ASCII");
    let numbers = |text: &str| -> Vec<u16> { text.split(';').filter_map(|part| part.parse().ok()).collect() };
    let place = numbers(before.rsplit_once("\u{1b}[").expect("a place").1.trim_end_matches('H'));
    let size = numbers(put["\u{1b}P0;1q\"1;1;".len()..].split('#').next().expect("a size"));
    // A pseudo-terminal without a pixel size: cells of 8 x 16 are assumed.
    let (columns, rows) = (size[0].div_ceil(8), size[1].div_ceil(16));
    assert!(columns > 20 && place[0] - 1 + rows <= 26 && place[1] - 1 + columns <= 100, "{place:?} {size:?}");

    support::wait_until(30, "the picture is written over", || {
        console.press("\u{1b}");
        let [_, _, behind] = pictures(&console, "\u{1b}P0;1q\"1;1;", "\u{1b}\\\u{1b}8", 1);
        let size = |cells| std::num::NonZeroU16::new(cells).expect("not zero");
        let mut terminal = vt100::Parser::new(size(30), size(100), 0);
        for row in 1..=30 {
            terminal.process(format!("\u{1b}[{row};1H{}", "▒".repeat(100)).as_bytes());
        }
        terminal.process(&behind);
        let covered = |row, column| terminal.screen().cell(row, column).is_none_or(|cell| cell.contents() == "▒");
        let mut cells = (0..rows).flat_map(|row| (0..columns).map(move |column| (row, column)));
        (!cells.any(|(row, column)| covered(place[0] - 1 + row, place[1] - 1 + column))).then_some(())
    });
    console.press("q");
    console.wait(30);
    console.expect_restored();
}

/// The grantee's console shows the picture, the values and the path.
fn expect_seen(reader: &Authros) {
    let mut console = picture_opened(reader);
    support::wait_until(30, "the picture in half-blocks", || {
        (console.shown().matches('▀').count() > 300).then_some(())
    });
    console.press("\t");
    console.wait_for("640 x 480", 60);
    console.press("q");
    console.press("/");
    console.press("\u{15}odom\r");
    support::wait_until(30, "the filter leaves odometry", || {
        let shown = console.shown();
        (shown.contains("/robot1/odom") && !shown.contains(CAMERA)).then_some(())
    });
    opened(&mut console, "Linear velocity, m/s");
    console.press("\t");
    console.wait_for("Path: last", 30);
    assert!(console.shown().contains("this record"), "{}", console.shown());
    console.press("qq");
    console.wait(30);
    console.expect_restored();
}

fn publish(home: &Home, roscore: &Roscore, topic: &str, name: &str, file: &Path, hz: &str) -> Running {
    let mut command = Command::new("/usr/bin/python3");
    command.env("PATH", "/usr/bin:/bin").env("HOME", home.root()).env("ROS_LOG_DIR", home.root().join("log"));
    command.env("ROS_MASTER_URI", roscore.uri()).env("ROS_HOSTNAME", "127.0.0.1").env_remove("ROS_IP");
    command.arg(concat!(env!("CARGO_MANIFEST_DIR"), "/tests/support/rospy_messages.py"));
    command.args(["publish", topic, name, file.to_str().expect("UTF-8"), hz]);
    let mut running = Running::start(command);
    running.wait_for_text("publishing", 60);
    running
}

/// A message's body without the `header.seq` that rospy increments.
fn without_seq(body: &[u8]) -> &[u8] {
    &body[4..]
}

#[test]
fn a_raw_picture_is_compressed_sealed_and_restored() {
    let Some(roscore) = Roscore::start() else { skipped!(NO_ROS) };
    let home = Home::new();
    let file = home.root().join("picture");
    rospy(&["image", "1280", "720", file.to_str().expect("UTF-8")]);
    let _camera = publish(&home, &roscore, "/camera", "sensor_msgs/Image", &file, "4");
    let _site = home.authros().with(&["--ros-master", &roscore.uri()]).serve(&home);
    let (alice, bob) = (home.profile("alice"), home.profile("bob"));
    alice.enrol();
    let address = bob.enrol();
    alice.json(&["grant", "add", &address]);
    alice.capture(&["/camera"], 1);
    let id = text(&bob.records(&["received", "list", "--oldest"])[0], "id");
    let opened = bob.json(&["records", "open", &id]);
    let (bytes, stored) = (count(&opened, "bytes"), count(&opened, "stored"));
    assert_eq!(opened["compression"], "matrix", "{opened}");
    assert!(stored < bytes / 2, "{stored} of {bytes} bytes sealed");
    let sent = fs::read(&file).expect("made");
    assert_eq!(bytes, u64::try_from(sent.len()).expect("fits"));
    let restored = written(&bob, &home, &id, "restored.bin");
    assert!(without_seq(&restored) == without_seq(&sent), "the very bytes that were published");
    let pixels = &sent[sent.len() - 1280 * 720 * 3..];
    assert!(rgb_of_png(&written(&bob, &home, &id, "b.png")) == pixels);
    let matrix = written(&bob, &home, &id, "b.npy");
    assert!(matrix.starts_with(b"\x93NUMPY") && matrix.ends_with(pixels), "the matrix as it is");
}

/// The peak memory of a process, bytes.
fn peak(process: &str) -> u64 {
    let status = fs::read_to_string(format!("/proc/{process}/status")).expect("a process");
    let line = status.lines().find(|line| line.starts_with("VmHWM")).expect("VmHWM");
    let kibibytes: u64 = line.split_whitespace().nth(1).and_then(|number| number.parse().ok()).expect("a number");
    kibibytes * 1024
}

#[test]
fn a_message_of_64_mib_is_taken_and_opened_within_bounds() {
    let _alone = heavy();
    let Some(roscore) = Roscore::start() else { skipped!(NO_ROS) };
    let mebibytes = if long() { 64 } else { 24 };
    let home = Home::new();
    let file = home.root().join("large");
    let length = mebibytes * MEBIBYTE - 12;
    rospy(&["array", &length.to_string(), file.to_str().expect("UTF-8")]);
    let site = home.authros().with(&["--ros-master", &roscore.uri()]).serve(&home);
    let authros = home.authros();
    authros.enrol();
    let before = peak(&site.id().to_string());
    let publisher = publish(&home, &roscore, "/large", "std_msgs/UInt8MultiArray", &file, "1");
    authros.capture(&["/large"], 1);
    drop(publisher);
    let taken = peak(&site.id().to_string());
    let id = text(&authros.records(&["records", "list", "--oldest"])[0], "id");
    let restored = written(&authros, &home, &id, "restored.bin");
    assert!(restored == fs::read(&file).expect("made"), "the very bytes");
    let opened = peak(&site.id().to_string());
    let in_mebibytes = |bytes: u64| bytes / MEBIBYTE;
    println!(
        "{mebibytes} MiB: {} MiB before, {} taken, {} opened",
        in_mebibytes(before),
        in_mebibytes(taken),
        in_mebibytes(opened)
    );
    assert!(opened <= before + (8 * mebibytes + 96) * MEBIBYTE, "{} MiB", in_mebibytes(opened));
}

const HOSTILE: &str = "AUTHROS_TEST_HOSTILE";

/// In a separate process, so that its memory is its own.
#[test]
fn hostile_messages_cost_no_more_than_the_cap() {
    if std::env::var_os(HOSTILE).is_some() {
        return hostile();
    }
    let mut command = Command::new(std::env::current_exe().expect("this test"));
    command.args(["--exact", "messages::hostile_messages_cost_no_more_than_the_cap", "--nocapture"]).env(HOSTILE, "1");
    let outcome = Running::start(command).wait(120).expect_code(0);
    assert!(outcome.stdout.contains("grown by"), "{outcome}");
}

fn hostile() {
    let cap = authros::ros::readable::DECODER_MEMORY as u64;
    let before = peak("self");
    let image = "uint32 height\nuint32 width\nstring encoding\nuint8 is_bigendian\nuint32 step\nuint8[] data";
    let image = Definition::parse("sensor_msgs/Image", image).expect("definition");
    let picture = Definition::parse("sensor_msgs/CompressedImage", "string format\nuint8[] data").expect("definition");
    let claim = u32::MAX.to_le_bytes();
    for fields in [
        "uint8[] x",
        "float64[] x",
        "string[] x",
        "time[] x",
        "a/B[] x\n================================================================================\nMSG: a/B\nuint8 K=1",
    ] {
        let definition = Definition::parse("a/Root", fields).expect("definition");
        assert!(definition.decode(&claim, Limits::default()).is_err() || fields.contains("a/B"), "{fields}");
        drop(definition.write_json(&claim, &mut std::io::sink()));
    }
    for (width, height) in [(4_000, 3_000), (10_000, 10_000), (60_000, 60_000)] {
        let bomb = bomb(width, height);
        assert!(bomb.len() < 200_000, "{}", bomb.len());
        let body = [&[0; 4][..], &u32::try_from(bomb.len()).expect("short").to_le_bytes(), &bomb].concat();
        let readable = read(&picture, &body).expect("fits its definition");
        assert_eq!(readable.picture.is_some(), width == 4_000, "{:?}", readable.lines);
        assert_eq!(export(Exported::Npy, &picture, &body).is_ok(), width == 4_000);
        let raw = [
            &height.to_le_bytes()[..],
            &width.to_le_bytes(),
            &4u32.to_le_bytes(),
            b"rgb8",
            &[0],
            &(width * 3).to_le_bytes(),
            &[0; 4],
        ]
        .concat();
        assert!(read(&image, &raw).is_some_and(|readable| readable.picture.is_none()), "no data behind its claim");
    }
    let grown = peak("self") - before;
    println!("grown by {} MiB", grown / MEBIBYTE);
    assert!(grown <= cap + 32 * MEBIBYTE, "grown by {} MiB, the cap is {}", grown / MEBIBYTE, cap / MEBIBYTE);
}

/// A black PNG, written row by row, using as little memory as the file is small.
fn bomb(width: u32, height: u32) -> Vec<u8> {
    let mut out = Vec::new();
    write_black(&mut out, width, height);
    out
}

fn write_black(out: &mut Vec<u8>, width: u32, height: u32) {
    let mut encoder = png::Encoder::new(out, width, height);
    encoder.set_color(png::ColorType::Grayscale);
    encoder.set_depth(png::BitDepth::One);
    let mut writer = encoder.write_header().expect("a header");
    // The largest is nothing but its claim.
    if height <= 10_000 {
        let mut rows = writer.stream_writer().expect("a writer");
        let row = vec![0; usize::try_from(width.div_ceil(8)).expect("fits")];
        for _ in 0..height {
            std::io::Write::write_all(&mut rows, &row).expect("written");
        }
        rows.finish().expect("written");
    }
}
