//! Hash slots of a Redis cluster: which node has which keys.

/// How many there are.
pub(super) const SLOTS: u16 = 16_384;

/// The slot of a key without a hash tag: CRC-16/XMODEM of it (Redis cluster specification, appendix A).
pub(super) fn slot(key: &str) -> u16 {
    let crc = key.bytes().fold(0u16, |crc, byte| {
        (0..8).fold(
            crc ^ (u16::from(byte) << 8),
            |crc, _| {
                if crc & 0x8000 == 0 { crc << 1 } else { (crc << 1) ^ 0x1021 }
            },
        )
    });
    crc % SLOTS
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn slots_are_those_of_the_specification() {
        // The specification's own check value, and slots that `CLUSTER KEYSLOT` of Redis 7.0 gives.
        assert_eq!((slot("123456789"), 0x31c3 % SLOTS), (12_739, 12_739));
        assert_eq!((slot("foo"), slot("bar"), slot("")), (12_182, 5_061, 0));
    }
}
