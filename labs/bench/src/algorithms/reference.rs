//! SM4-GCM by other implementations alone, the tag appended: the crates sm4, ctr and ghash, and libsm's own mode.

use ctr::cipher::{
    BlockCipherEncrypt as _, InnerIvInit as _, KeyInit as _, StreamCipher as _, StreamCipherCoreWrapper,
};
use ctr::{CtrCore, flavors::Ctr32BE};
use ghash::universal_hash::UniversalHash as _;
use ghash::{Block, GHash};
use libsm::sm4::cipher_mode::{CipherMode, Sm4CipherMode};
use sm4::Sm4;

use authros_service::Failure;
use authros_service::reply::internal;

/// With the crates sm4, ctr and ghash.
pub(super) fn seal_by_crates(key: &[u8; 16], nonce: &[u8; 12], aad: &[u8], text: &mut Vec<u8>) -> Result<(), Failure> {
    let cipher = Sm4::new(&(*key).into());
    let counter = |number: u8| {
        let mut block = [0; 16];
        block[..12].copy_from_slice(nonce);
        block[15] = number;
        block
    };
    let encrypted = |block: [u8; 16]| -> [u8; 16] {
        let mut block = block.into();
        cipher.encrypt_block(&mut block);
        block.into()
    };
    let core = CtrCore::<_, Ctr32BE>::inner_iv_init(cipher.clone(), &counter(2).into());
    let masked = StreamCipherCoreWrapper::from_core(core).try_apply_keystream(text);
    masked.map_err(|_| internal("SM4 in counter mode"))?;
    let mut hash = GHash::new(&Block::from(encrypted([0; 16])));
    hash.update_padded(aad);
    hash.update_padded(text);
    let bits = [aad.len(), text.len()].map(|length| (length as u64 * 8).to_be_bytes());
    let mut lengths = [0; 16];
    lengths.copy_from_slice(bits.as_flattened());
    hash.update(&[Block::from(lengths)]);
    let tag: [u8; 16] = hash.finalize().into();
    text.extend(tag.iter().zip(encrypted(counter(1))).map(|(byte, mask)| byte ^ mask));
    Ok(())
}

/// With libsm's mode, which takes 16 bytes of nonce.
pub(super) fn seal_by_libsm(key: &[u8; 16], nonce: &[u8; 16], aad: &[u8], text: &[u8]) -> Result<Vec<u8>, Failure> {
    let mode = Sm4CipherMode::new(key, CipherMode::Gcm).map_err(|_| internal("SM4"))?;
    mode.encrypt(aad, text, nonce).map_err(|_| internal("SM4-GCM"))
}

#[cfg(test)]
mod tests {
    use super::*;
    use authros_crypto::{ProviderName, provider};

    #[test]
    fn the_crates_seal_as_the_product_does() {
        let (key, nonce, aad) = ([7; 16], [9; 12], [1, 2, 3]);
        for length in [0, 1, 16, 1000] {
            let mut expected = vec![0x5a; length];
            provider(ProviderName::default()).gcm_seal(&key, &nonce, &aad, &mut expected).expect("seals");
            let mut sealed = vec![0x5a; length];
            seal_by_crates(&key, &nonce, &aad, &mut sealed).expect("seals");
            assert_eq!(sealed, expected, "{length} bytes");
        }
    }
}
