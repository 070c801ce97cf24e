//! Well-known messages, valid and hostile, and pictures that claim too much.

use super::picture::{DECODER_MEMORY, MOST_PIXELS, decode, png_file};
use super::*;
use crate::ros::robot::{ODOMETRY, odometry_definition};

const HEADER: &str = "uint32 seq\ntime stamp\nstring frame_id";

/// A message built field by field.
#[derive(Default)]
struct Bytes(Vec<u8>);

impl Bytes {
    fn header() -> Self {
        Self::default().u32(7).u32(1_700_000_000).u32(5).text("base")
    }

    fn u32(mut self, number: u32) -> Self {
        self.0.extend(number.to_le_bytes());
        self
    }

    fn text(self, text: &str) -> Self {
        self.bytes(text.as_bytes())
    }

    fn bytes(self, bytes: &[u8]) -> Self {
        let mut with = self.u32(u32::try_from(bytes.len()).expect("short"));
        with.0.extend(bytes);
        with
    }

    fn u8(mut self, number: u8) -> Self {
        self.0.push(number);
        self
    }

    fn floats(mut self, numbers: &[f32]) -> Self {
        numbers.iter().for_each(|number| self.0.extend(number.to_le_bytes()));
        self
    }

    fn doubles(mut self, numbers: &[f64]) -> Self {
        numbers.iter().for_each(|number| self.0.extend(number.to_le_bytes()));
        self
    }
}

fn definition(name: &str, text: &str, nested: &[(&str, &str)]) -> Definition {
    let rule = "=".repeat(80);
    let header = [("std_msgs/Header", HEADER)];
    let sections = header.iter().chain(nested).map(|(name, text)| format!("\n{rule}\nMSG: {name}\n{text}"));
    let text: String = std::iter::once(text.to_owned()).chain(sections).collect();
    Definition::parse(name, &text).expect("definition")
}

fn image() -> Definition {
    let text =
        "Header header\nuint32 height\nuint32 width\nstring encoding\nuint8 is_bigendian\nuint32 step\nuint8[] data";
    definition("sensor_msgs/Image", text, &[])
}

fn compressed() -> Definition {
    definition("sensor_msgs/CompressedImage", "Header header\nstring format\nuint8[] data", &[])
}

fn image_body(size: (u32, u32), encoding: &str, pixel: u32, data: &[u8]) -> Vec<u8> {
    let head = Bytes::header().u32(size.1).u32(size.0).text(encoding).u8(0);
    head.u32(size.0 * pixel).bytes(data).0
}

fn line<'a>(readable: &'a Readable, label: &str) -> &'a str {
    let found = readable.lines.iter().find(|(name, _)| name == label);
    found.map_or_else(|| panic!("no line {label} in {readable:?}"), |(_, value)| value.as_str())
}

#[test]
fn odometry_in_the_papers_words() {
    let definition = Definition::parse(ODOMETRY, &odometry_definition()).expect("definition");
    let mut covariance = [0.0; 36];
    covariance[7] = 0.25;
    let half = std::f64::consts::FRAC_PI_8;
    let body = Bytes::header()
        .text("base_link")
        .doubles(&[1.5, -2.0, 0.0, 0.0, 0.0, half.sin(), half.cos()])
        .doubles(&covariance)
        .doubles(&[0.6, 0.0, 0.0, 0.0, 0.0, 0.125])
        .doubles(&[0.0; 36])
        .0;
    let readable = read(&definition, &body).expect("known");
    assert_eq!(line(&readable, "Linear velocity, m/s"), "x 0.6  y 0  z 0");
    assert_eq!(line(&readable, "Angular velocity, rad/s"), "x 0  y 0  z 0.125");
    assert_eq!(line(&readable, "Pose, m"), "x 1.5  y -2  z 0");
    assert_eq!(line(&readable, "Orientation"), "roll 0°  pitch 0°  yaw 45°");
    assert_eq!(line(&readable, "Stamp (UTC)"), "2023-11-14T22:13:20.000Z (1700000000.000000005)");
    assert_eq!((readable.tables[0].rows.len(), readable.tables[0].rows[1][2].as_str()), (6, "0.25"));
    let here = place(&definition, &body).expect("a place");
    assert_eq!(here, Place::Metres(1.5, -2.0));
    let track = track("Path", &[Place::Metres(0.0, 0.0), here], Some(here)).expect("a path");
    assert_eq!((track.points.len(), track.here), (2, Some((1.5, -2.0))));
}

#[test]
fn fixes_become_metres_around_the_first() {
    let places = [Place::Degrees(7.0, 50.0), Place::Degrees(7.0, 50.001), Place::Degrees(7.001, 50.0)];
    let track = track("Track", &places, None).expect("a track");
    assert!((track.points[1].1 - 111.195).abs() < 0.01 && track.points[1].0.abs() < 1e-9, "{track:?}");
    assert!((track.points[2].0 - 71.475).abs() < 0.01, "{track:?}");
}

#[test]
fn a_scan_is_seen_from_above_without_what_is_out_of_range() {
    let text = "Header header\nfloat32 angle_min\nfloat32 angle_max\nfloat32 angle_increment\nfloat32 time_increment\n\
        float32 scan_time\nfloat32 range_min\nfloat32 range_max\nfloat32[] ranges\nfloat32[] intensities";
    let definition = definition("sensor_msgs/LaserScan", text, &[]);
    for beams in [400, 2_000, 20_000] {
        let mut ranges = vec![2.0f32; beams];
        ranges[0] = f32::NAN;
        ranges[1] = 99.0;
        let head = Bytes::header().floats(&[0.0, 3.0, 0.0, 0.0, 0.1, 0.1, 10.0]);
        let body = head.u32(u32::try_from(beams).expect("few")).floats(&ranges).u32(0).0;
        let readable = read(&definition, &body).expect("known");
        assert_eq!(line(&readable, "Beams"), format!("{beams}, of these {} in range", beams - 2));
        let plot = readable.plot.expect("a plot");
        assert!(plot.points.len() <= MOST_POINTS && plot.points.len() >= 300);
        assert!(plot.points.iter().all(|point| *point == (2.0, 0.0)));
    }
}

fn cloud() -> (Definition, Vec<u8>) {
    let text = "Header header\nuint32 height\nuint32 width\nPointField[] fields\nbool is_bigendian\nuint32 point_step\n\
        uint32 row_step\nuint8[] data\nbool is_dense";
    let field = ("sensor_msgs/PointField", "string name\nuint32 offset\nuint8 datatype\nuint32 count");
    let mut body = Bytes::header().u32(1).u32(500).u32(3);
    for (place, name) in ["x", "y", "z"].into_iter().enumerate() {
        body = body.text(name).u32(u32::try_from(place * 4).expect("small")).u8(7).u32(1);
    }
    let points: Vec<u8> = (0..500u16)
        .flat_map(|at| [f32::from(at), 1.0, if at == 3 { f32::NAN } else { 2.5 }])
        .flat_map(f32::to_le_bytes)
        .collect();
    let body = body.u8(0).u32(12).u32(6000).bytes(&points).u8(1).0;
    (definition("sensor_msgs/PointCloud2", text, &[field]), body)
}

#[test]
fn a_cloud_is_seen_from_above() {
    let (definition, body) = cloud();
    let readable = read(&definition, &body).expect("known");
    assert_eq!(line(&readable, "Points"), "500 (500 x 1)");
    assert_eq!(line(&readable, "Heights"), "2.5 m to 2.5 m");
    assert_eq!(readable.tables[0].rows[2], ["z", "8", "float32", "1"]);
    let plot = readable.plot.expect("a plot");
    assert_eq!((plot.points.len(), plot.points[499]), (500, (499.0, 1.0)));
    // A field beyond its point is not followed.
    let mut hostile = body.clone();
    let offset = hostile.windows(5).position(|bytes| bytes == [1, 0, 0, 0, b'x']).expect("x") + 5;
    hostile[offset..offset + 4].copy_from_slice(&u32::MAX.to_le_bytes());
    assert_eq!(read(&definition, &hostile).expect("known").plot, None);
    for end in 0..body.len() {
        assert_eq!(read(&definition, &body[..end]), None);
    }
}

#[test]
fn diagnostics_and_joints_as_tables() {
    let text = "Header header\nDiagnosticStatus[] status";
    let status = (
        "diagnostic_msgs/DiagnosticStatus",
        "byte level\nstring name\nstring message\nstring hardware_id\nKeyValue[] values",
    );
    let pair = ("diagnostic_msgs/KeyValue", "string key\nstring value");
    let diagnostics = definition("diagnostic_msgs/DiagnosticArray", text, &[status, pair]);
    let body = Bytes::header().u32(1).u8(2).text("motor\u{1b}[2J").text("hot").text("m1").u32(1).text("t").text("90").0;
    let readable = read(&diagnostics, &body).expect("known");
    assert_eq!(readable.tables[0].rows[0], ["ERROR", "motor\u{fffd}[2J", "hot", "m1"]);
    assert_eq!(readable.tables[1].rows[0], ["motor\u{fffd}[2J", "t", "90"]);

    let text = "Header header\nstring[] name\nfloat64[] position\nfloat64[] velocity\nfloat64[] effort";
    let joints = definition("sensor_msgs/JointState", text, &[]);
    let body = Bytes::header().u32(2).text("a").text("b").u32(2).doubles(&[0.5, 1e-9]).u32(0).u32(0).0;
    let readable = read(&joints, &body).expect("known");
    assert_eq!(readable.tables[0].rows, [["a", "0.5", "-", "-"], ["b", "1.000e-9", "-", "-"]]);
}

#[test]
fn raw_pictures_of_every_kind() {
    let red_first = [200, 100, 50].repeat(24 * 20);
    let readable = read(&image(), &image_body((24, 20), "rgb8", 3, &red_first)).expect("known");
    let raster = readable.picture.expect("a picture");
    assert_eq!((raster.width, raster.height, raster.pixel(5, 5)), (24, 20, [200, 100, 50]));
    let of = |encoding: &str, pixel: u32, data: &[u8]| {
        let readable = read(&image(), &image_body((24, 20), encoding, pixel, data)).expect("known");
        readable.picture.unwrap_or_else(|| panic!("{encoding}: {:?}", readable.lines)).pixel(8, 8)
    };
    assert_eq!(of("bgr8", 3, &red_first), [50, 100, 200]);
    assert_eq!(of("mono8", 1, &[77; 480]), [77; 3]);
    assert_eq!(of("mono16", 2, &[1, 77].repeat(480)), [0, 0, 0].map(|_| of("mono16", 2, &[1, 77].repeat(480))[0]));
    let mosaic: Vec<u8> = (0..20).flat_map(|y| (0..24).map(move |x| [[200, 100], [100, 50]][y % 2][x % 2])).collect();
    assert_eq!(of("bayer_rggb8", 1, &mosaic), [200, 100, 50]);
    assert_eq!(of("bayer_bggr8", 1, &mosaic), [50, 100, 200]);
    let depth: Vec<u8> = (0..480u16).flat_map(|at| (1000 + at).to_le_bytes()).collect();
    assert!(of("16UC1", 2, &depth)[0] > 80);
    let depth: Vec<u8> =
        (0..480u16).flat_map(|at| if at == 3 { f32::NAN } else { f32::from(at) }.to_le_bytes()).collect();
    assert!(of("32FC1", 4, &depth)[0] > 80);
    assert_eq!(of("yuv422", 2, &[128, 90].repeat(480)), [90; 3]);
}

#[test]
fn what_does_not_agree_is_said_and_not_shown() {
    for body in [
        image_body((24, 20), "rgb8", 3, &[0; 100]),
        image_body((24, 20), "rgb8", 1, &[0; 1440]),
        image_body((u32::MAX, u32::MAX), "rgb8", 0, &[0; 1440]),
        image_body((24, 20), "mystery\u{202e}", 3, &[0; 1440]),
        image_body((0, 0), "rgb8", 3, &[]),
    ] {
        let readable = read(&image(), &body).expect("fits its definition");
        assert!(readable.picture.is_none() && !line(&readable, "Not shown").contains('\u{202e}'));
    }
}

#[test]
fn files_hold_the_matrix() {
    let depth: Vec<u8> = (0..480u16).flat_map(|at| (at * 100).to_le_bytes()).collect();
    let body = image_body((24, 20), "16UC1", 2, &depth);
    let file = export(Exported::Npy, &image(), &body).expect("a matrix");
    assert!(file.starts_with(b"\x93NUMPY\x01\x00v\x00{'descr': '<u2', 'fortran_order': False, 'shape': (20, 24), }"));
    assert_eq!((&file[128..], file[127]), (&depth[..], b'\n'));
    let png = export(Exported::Png, &image(), &body).expect("a picture");
    let mut reader = png::Decoder::new(std::io::Cursor::new(&png)).read_info().expect("PNG");
    let mut back = vec![0; reader.output_buffer_size().expect("small")];
    reader.next_frame(&mut back).expect("whole");
    assert!(back.chunks(2).zip(0..480u16).all(|(pixel, at)| pixel == (at * 100).to_be_bytes()), "16 bits are kept");
    assert!(
        decode(&png)
            .expect("PNG")
            .rgb
            .chunks(3)
            .zip(0..480u16)
            .all(|(pixel, at)| { pixel.iter().all(|sample| (u16::from(*sample) * 257).abs_diff(at * 100) <= 128) })
    );
    let rgb: Vec<u8> = (0..1440u16).map(|at| u8::try_from(at % 251).expect("small")).collect();
    let body = image_body((24, 20), "bgr8", 3, &rgb);
    let png = decode(&export(Exported::Png, &image(), &body).expect("a picture")).expect("PNG");
    let swapped: Vec<u8> = rgb.as_chunks::<3>().0.iter().flat_map(|[b, g, r]| [*r, *g, *b]).collect();
    assert_eq!(png.rgb, swapped);
    let jpeg = export(Exported::Jpeg, &image(), &body).expect("a picture");
    assert!(jpeg.starts_with(&[0xff, 0xd8]));
    let message = Bytes::header().text("jpeg").bytes(&jpeg).0;
    assert_eq!(export(Exported::Jpeg, &compressed(), &message), Ok(jpeg), "its own bytes");
    assert!(export(Exported::Png, &compressed(), &message).is_ok_and(|png| png.starts_with(b"\x89PNG")));
    assert_eq!(export(Exported::Bin, &compressed(), &message), Ok(message));
    let (definition, body) = cloud();
    assert!(matches!(export(Exported::Png, &definition, &body), Err(PictureError::NoPicture(_))));
}

/// A PNG that claims to be larger than it is; its checksum matches.
fn claiming(width: u32, height: u32) -> Vec<u8> {
    let mut png = png_file(&[0; 12], (2, 2), png::ColorType::Rgb, png::BitDepth::Eight).expect("encodes");
    png[16..20].copy_from_slice(&width.to_be_bytes());
    png[20..24].copy_from_slice(&height.to_be_bytes());
    let sum = png[12..29].iter().fold(u32::MAX, |sum, byte| {
        (0..8).fold(sum ^ u32::from(*byte), |sum, _| sum >> 1 ^ if sum & 1 == 1 { 0xedb8_8320 } else { 0 })
    });
    png[29..33].copy_from_slice(&(!sum).to_be_bytes());
    png
}

#[test]
fn pictures_that_claim_too_much_are_refused_before_they_are_decoded() {
    assert_eq!(decode(&claiming(10_000, 10_000)), Err(PictureError::Large(10_000, 10_000)));
    assert!(decode(&claiming(u32::MAX >> 1, 3)).is_err());
    assert!(matches!(decode(&claiming(4_000, 3_000)), Err(PictureError::Broken(_))), "allowed, but not there");
    assert!(decode(b"\xff\xd8\xff").is_err() && decode(b"").is_err());
    const { assert!(MOST_PIXELS * 8 <= DECODER_MEMORY as u64) };
}

proptest::proptest! {
    #[test]
    fn noise_never_panics(noise in proptest::collection::vec(proptest::prelude::any::<u8>(), 0..600)) {
        for definition in [image(), compressed(), cloud().0] {
            let _ = read(&definition, &noise);
            for kind in [Exported::Png, Exported::Jpeg, Exported::Npy, Exported::Json] {
                let _ = export(kind, &definition, &noise);
            }
        }
        let _ = decode(&noise);
    }
}
