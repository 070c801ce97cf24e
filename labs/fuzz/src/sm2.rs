//! SM2 by our kernels compared with the crate's and libsm's: keys, signatures, ciphertexts and points on which all must
//! agree. The valid samples are the standard's own (GB/T 32918.5-2017, annexes A and C).

use authros::crypto::{Ephemeral, Provider, ProviderName, SmSecret, provider};
use authros::model::bytes::unhex;
use authros::model::{PublicKey, Signature};

use crate::{Sample, masked, sample, way};

const WAYS: u8 = 6;
const SECRET: &str = "3945208f7b2144b13f36e38ac6d39f95889393692860b51a42fb81ef4df7c5b8";
const PUBLIC: &str = "09f9df311e5421a150dd7d161e4bc5c672179fad1833fc076bb08ff356f35020\
                      ccea490ce26775a52dc6ea718cc1aa600aed05fbf35e084a6632f6072da9ad13";
const SIGNATURE: &str = "f5a03b0648d2c4630eeac513e1bb81a15944da3827d5b74143ac7eaceee720b3\
                         b1b6aa29df212fd8763182bc0d421ca1bb9038fd1f7f42d4840b69c485bbc1aa";
const MESSAGE: &[u8] = b"message digest";
const CIPHERTEXT: &str = "307c022004ebfc718e8d1798620432268e77feb6415e2ede0e073c0f4f640ecd2e149a73\
                          022100e858f9d81e5430a57b36daab8f950a3c64e6ee6a63094d99283aff767e124df0\
                          042059983c18f809e262923c53aec295d30383b54e39d609d160afcb1908d0bd8766\
                          041321886ca989ca9c7d58087307ca93092d651efa";

fn hex(text: &str) -> Vec<u8> {
    unhex(text).expect("hex")
}

/// The common result of all providers.
fn alike<T: PartialEq + std::fmt::Debug>(what: impl Fn(&'static dyn Provider) -> T) -> T {
    let [ours, one, other] = ProviderName::ALL.map(|name| what(provider(name)));
    assert_eq!(ours, one, "ours and the crate's differ");
    assert_eq!(ours, other, "ours and libsm's differ");
    ours
}

/// Any input to SM2.
pub fn run(data: &[u8]) -> bool {
    match way(data, WAYS) {
        Some((0, bytes)) => signature(bytes),
        Some((1, mask)) => {
            let (bytes, changed) = masked(&genuine(), mask);
            let valid = signature(&bytes);
            assert_ne!(valid, changed, "an altered signature, key or message, or the standard's own");
            valid
        }
        Some((2, bytes)) => signing(bytes),
        Some((3, der)) => ciphertext(der),
        Some((4, mask)) => {
            let (der, changed) = masked(&hex(CIPHERTEXT), mask);
            let opened = ciphertext(&der);
            assert_ne!(opened, changed, "an altered ciphertext, or the standard's own");
            opened
        }
        Some((5, bytes)) => point(bytes),
        _ => false,
    }
}

/// The standard's public key, signature and message.
fn genuine() -> Vec<u8> {
    [hex(PUBLIC), hex(SIGNATURE), MESSAGE.to_vec()].concat()
}

fn signature(bytes: &[u8]) -> bool {
    let Some((public, rest)) = bytes.split_first_chunk() else { return false };
    let Some((signature, message)) = rest.split_first_chunk() else { return false };
    let (public, signature) = (PublicKey(*public), Signature(*signature));
    let valid = alike(|provider| provider.verify(&public, message, &signature).is_ok());
    // The second time the signer may be known.
    assert_eq!(provider(ProviderName::Authros).verify(&public, message, &signature).is_ok(), valid);
    valid
}

fn signing(bytes: &[u8]) -> bool {
    let Some((secret, message)) = bytes.split_at_checked(32) else { return false };
    let Ok(secret) = SmSecret::from_slice(secret) else { return false };
    let public = alike(|provider| provider.public_key(&secret).expect("a point"));
    for signer in ProviderName::ALL.map(provider) {
        let signature = signer.sign(&secret, message).expect("signs");
        assert!(alike(|provider| provider.verify(&public, message, &signature).is_ok()), "{}", signer.name());
    }
    true
}

fn ciphertext(der: &[u8]) -> bool {
    let secret = SmSecret::from_slice(&hex(SECRET)).expect("in range");
    alike(|provider| provider.decrypt(&secret, der).ok().map(|plain| plain.to_vec())).is_some()
}

fn point(bytes: &[u8]) -> bool {
    let Ok(public) = bytes.try_into().map(PublicKey) else { return false };
    let on_curve = alike(|provider| provider.check_public_key(&public).is_ok());
    let secret = SmSecret::from_slice(&hex(SECRET)).expect("in range");
    let agreed = Ephemeral::from_secret(provider(ProviderName::Authros), secret).expect("a pair").agree(&public);
    assert_eq!(agreed.is_ok(), on_curve);
    on_curve
}

/// The standard's examples, and the edges of what is allowed.
pub fn samples() -> Vec<Sample> {
    let order = hex("fffffffeffffffffffffffffffffffff7203df6b21c6052b53bbf40939d54123");
    // r + s = n.
    let sum =
        [&hex(PUBLIC), &hex(SIGNATURE)[..32], &hex("0a5fc4f8b72d3b9cf1153aec1e447e5e18bf0532f9f04dea100f755c4aee2070")]
            .concat();
    let past = [hex(PUBLIC), order, hex(SIGNATURE)[32..].to_vec()].concat();
    // x = p, the same number as 0, where a point is.
    let not_canonical = [
        hex("fffffffeffffffffffffffffffffffffffffffff00000000ffffffffffffffff"),
        hex("fd4511e81736a60f07e88a83d6cf5a167fae6d1a9c9330e76e232e00f5cdc154"),
    ]
    .concat();
    vec![
        sample("signature", 0, &genuine()),
        sample("signature_sum_n", 0, &sum),
        sample("signature_r_is_n", 0, &past),
        sample("signature_masked", 1, &[0; 4]),
        sample("secret", 2, &[hex(SECRET), MESSAGE.to_vec()].concat()),
        sample("secret_one", 2, &[&[0; 31][..], &[1]].concat()),
        sample("ciphertext", 3, &hex(CIPHERTEXT)),
        sample("ciphertext_masked", 4, &[0; 4]),
        sample("point", 5, &hex(PUBLIC)),
        sample("point_not_canonical", 5, &not_canonical),
    ]
}
