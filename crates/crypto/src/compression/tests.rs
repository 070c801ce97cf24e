//! A round trip gives the same bytes, whatever they were, and never more than claimed.

use proptest::prelude::*;

use super::*;

fn restored(body: &[u8], matrix: Option<&Matrix>) -> Option<Compression> {
    let packed = pack(body, matrix)?;
    assert!(pays(&packed.bytes, body));
    assert_eq!(unpack(packed.compression, &packed.bytes, body.len()).as_deref(), Ok(body));
    for wrong in [body.len() - 1, body.len() + 1, body.len() * 1000] {
        assert!(unpack(packed.compression, &packed.bytes, wrong).is_err(), "{wrong}");
    }
    Some(packed.compression)
}

/// A smooth matrix with a header before and a trailer after it.
fn smooth(matrix: &Matrix, tail: usize) -> Vec<u8> {
    let mut body = vec![7; matrix.start];
    for row in 0..matrix.rows {
        for place in 0..matrix.columns * matrix.channels {
            let number = u32::try_from(row * 3 + place / 2).expect("small") + 0x4000_0000;
            let bytes = number.to_le_bytes();
            let mut bytes = bytes[..matrix.sample].to_vec();
            if matrix.big_endian {
                bytes.reverse();
            }
            body.extend(bytes);
        }
    }
    body.extend(vec![9; tail]);
    body
}

fn shape(rows: usize, columns: usize, channels: usize, sample: usize) -> Matrix {
    Matrix { start: 5, rows, columns, channels, sample, big_endian: false, apart: 1 }
}

#[test]
fn every_shape_of_matrix_comes_back() {
    for (rows, columns) in [(40, 50), (1, 3000), (700, 16), (64, 19)] {
        for channels in [1, 2, 3, 4, 7] {
            for sample in [1, 2, 4] {
                for (big_endian, apart) in [(false, 1), (true, 2)] {
                    let matrix = Matrix { big_endian, apart, ..shape(rows, columns, channels, sample) };
                    let body = smooth(&matrix, 3);
                    let packed = pack_matrix(&body, &matrix).expect("fits");
                    assert_eq!(unpack(Compression::Matrix, &packed, body.len()), Ok(body), "{matrix:?}");
                }
            }
        }
    }
}

#[test]
fn a_flat_matrix_becomes_next_to_nothing() {
    let matrix = shape(400, 400, 3, 1);
    let body = vec![77; 5 + matrix.length().expect("fits")];
    let packed = pack(&body, Some(&matrix)).expect("pays");
    assert!(packed.bytes.len() < 5000, "{}", packed.bytes.len());
    assert_eq!(unpack(packed.compression, &packed.bytes, body.len()), Ok(body));
}

#[test]
fn noise_and_small_messages_stay_as_they_are() {
    let mut state = 1u64;
    let mut noise = || {
        state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        u8::try_from(state >> 56).expect("a byte")
    };
    let body: Vec<u8> = (0..400_000).map(|_| noise()).collect();
    assert_eq!(pack(&body, None), None);
    assert_eq!(pack(&body, Some(&shape(300, 300, 3, 1))), None);
    assert_eq!(pack(&[0; SHORTEST - 1], None), None);
    assert_eq!(restored(&[0; SHORTEST], None), Some(Compression::Lz4));
}

#[test]
fn a_matrix_that_does_not_fit_its_message_is_none() {
    let body = vec![1; 1000];
    for matrix in [
        shape(1000, 1000, 3, 1),
        shape(usize::MAX, 4, 4, 4),
        shape(10, 10, 0, 1),
        shape(10, 10, 65, 1),
        shape(10, 10, 1, 3),
        shape(10, 0, 1, 1),
        shape(10, 15, 1, 1),
        Matrix { start: usize::MAX, ..shape(1, 1, 1, 1) },
    ] {
        assert_eq!(restored(&body, Some(&matrix)), Some(Compression::Lz4), "{matrix:?}");
    }
}

#[test]
fn a_bomb_is_refused() {
    assert!(unpack(Compression::Lz4, &[0x1f, 0, 1, 0, 255, 255], 1 << 26).is_err());
    let matrix = shape(16, 1 << 20, 4, 1);
    let mut bomb = pack(&vec![0; 5 + (1 << 16)], Some(&shape(16, 1 << 10, 4, 1))).expect("pays").bytes;
    bomb[4..12].copy_from_slice(&[0, 0, 0, 16, 0, 16, 0, 0]);
    assert!(unpack(Compression::Matrix, &bomb, 5 + matrix.length().expect("fits")).is_err());
    for end in 0..bomb.len() {
        assert!(unpack(Compression::Matrix, &bomb[..end], 5 + (1 << 16)).is_err());
    }
}

proptest! {
    #[test]
    fn whatever_it_was_comes_back(
        bytes in prop::collection::vec(0u8..20, SHORTEST..5000),
        start in 0usize..40, columns in 16usize..60, channels in 1usize..5, sample in 0usize..3,
        big_endian in any::<bool>(), apart in 1usize..3,
    ) {
        let sample = [1, 2, 4][sample];
        let rows = (bytes.len() - start) / (columns * channels * sample);
        let matrix = Matrix { start, rows, columns, channels, sample, big_endian, apart };
        let packed = pack_matrix(&bytes, &matrix).expect("fits");
        prop_assert_eq!(unpack(Compression::Matrix, &packed, bytes.len()), Ok(bytes.clone()));
        restored(&bytes, Some(&matrix));
    }

    #[test]
    fn noise_never_panics_nor_grows(noise in prop::collection::vec(any::<u8>(), 0..200), length in 0usize..5000) {
        for compression in [Compression::None, Compression::Lz4, Compression::Matrix] {
            if let Ok(plain) = unpack(compression, &noise, length) {
                prop_assert_eq!(plain.len(), length);
            }
        }
    }
}
