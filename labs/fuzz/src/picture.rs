//! Pictures as files and as raw matrices, and the codes under which messages are sealed.

use authros::crypto::compression::{Matrix, pack, unpack};
use authros::model::head::Compression;
use authros::ros::Definition;
use authros::ros::readable::{Exported, MOST_PIXELS, decode, export, read};

use crate::{Sample, sample, way};

const WAYS: u8 = 4;

const IMAGE: &str = "uint32 height\nuint32 width\nstring encoding\nuint8 is_bigendian\nuint32 step\nuint8[] data";

/// Any claimed picture.
pub fn run(data: &[u8]) -> bool {
    match way(data, WAYS) {
        Some((0, bytes)) => file(bytes),
        Some((1, bytes)) => raw(bytes),
        Some((2, bytes)) => packed(bytes),
        Some((3, bytes)) => any_matrix(bytes),
        _ => false,
    }
}

fn file(bytes: &[u8]) -> bool {
    let Ok(picture) = decode(bytes) else { return false };
    assert!((picture.width * picture.height) as u64 <= MOST_PIXELS);
    true
}

fn raw(bytes: &[u8]) -> bool {
    let definition = Definition::parse("sensor_msgs/Image", IMAGE).expect("a definition");
    let Some(readable) = read(&definition, bytes) else { return false };
    for kind in [Exported::Npy, Exported::Png, Exported::Jpeg, Exported::Json] {
        drop(export(kind, &definition, bytes));
    }
    let Some(picture) = readable.picture else { return false };
    assert_eq!(picture.rgb.len(), picture.width * picture.height * 3);
    if let Some(matrix) = definition.matrix(bytes) {
        restored(bytes, Some(&matrix));
    }
    true
}

/// Code (1), length (2, big endian), packed bytes: exactly that length comes out.
fn packed(bytes: &[u8]) -> bool {
    let Some((head, rest)) = bytes.split_first_chunk::<3>() else { return false };
    let compression = if head[0].is_multiple_of(2) { Compression::Lz4 } else { Compression::Matrix };
    let length = usize::from(u16::from_be_bytes([head[1], head[2]]));
    let Ok(plain) = unpack(compression, rest, length) else { return false };
    assert_eq!(plain.len(), length);
    true
}

/// Start, columns, channels, sample, order, distance (1 each), body: comes back unchanged.
fn any_matrix(bytes: &[u8]) -> bool {
    let Some((shape, body)) = bytes.split_first_chunk::<6>() else { return false };
    let shape = shape.map(usize::from);
    let (columns, channels, sample) = (shape[1] + 1, shape[2] % 8 + 1, [1, 2, 4][shape[3] % 3]);
    let start = shape[0].min(body.len());
    let rows = (body.len() - start) / (columns * channels * sample);
    let matrix =
        Matrix { start, rows, columns, channels, sample, big_endian: shape[4] % 2 == 1, apart: shape[5] % 2 + 1 };
    restored(body, Some(&matrix))
}

fn restored(body: &[u8], matrix: Option<&Matrix>) -> bool {
    let Some(packed) = pack(body, matrix) else { return false };
    assert!(packed.bytes.len() < body.len());
    let plain = unpack(packed.compression, &packed.bytes, body.len()).expect("what was packed");
    assert!(plain == body, "not as it was");
    true
}

/// Valid pictures of every kind.
pub fn samples() -> Vec<Sample> {
    let image =
        [&[20, 0, 0, 0, 24, 0, 0, 0, 5, 0, 0, 0][..], b"mono8", &[0, 24, 0, 0, 0, 224, 1, 0, 0], &[90; 480]].concat();
    let definition = Definition::parse("sensor_msgs/Image", IMAGE).expect("a definition");
    let [png, jpeg] = [Exported::Png, Exported::Jpeg].map(|kind| export(kind, &definition, &image).expect("a picture"));
    let bytes =
        |compression: u8, packed: &[u8], length: u16| [&[compression][..], &length.to_be_bytes(), packed].concat();
    let lz4 = pack(&[7; 900], None).expect("pays").bytes;
    let body = vec![9; 5 + 40 * 48];
    let matrix = Matrix { start: 5, rows: 40, columns: 48, channels: 1, sample: 1, big_endian: false, apart: 1 };
    let coded = pack(&body, Some(&matrix)).expect("pays").bytes;
    vec![
        sample("png", 0, &png),
        sample("jpeg", 0, &jpeg),
        sample("image", 1, &image),
        sample("lz4", 2, &bytes(0, &lz4, 900)),
        sample("matrix", 2, &bytes(1, &coded, 1925)),
        sample("any_matrix", 3, &[&[5, 47, 0, 0, 0, 0][..], &body].concat()),
    ]
}
