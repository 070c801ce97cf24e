//! The arithmetic of SM2 (GB/T 32918-2016). Code that handles secrets (`secret`, and everything below it) takes the
//! same time for all of them; code that verifies (`public`) need not.

#![allow(clippy::inline_always, reason = "a call costs as much as what is called")]

mod complete;
mod field;
mod limbs;
mod point;
mod public;
mod scalar;
mod secret;
#[cfg(target_arch = "x86_64")]
mod way;
#[cfg(target_arch = "x86_64")]
mod x86_64;

#[cfg(test)]
mod tests;

pub(crate) use point::Affine;
pub(crate) use public::{Signer, SignerTable, verifies};
pub(crate) use scalar::Scalar;
pub(crate) use secret::{multiply, multiply_both, multiply_generator};

/// Builds the tables of the generator's multiples, which otherwise the first signature or verification builds.
pub(crate) fn warm_up() {
    secret::warm_up();
    public::warm_up();
}
