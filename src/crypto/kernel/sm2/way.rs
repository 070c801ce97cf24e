//! Which products modulo the SM2 prime are used: those by BMI2 and ADX where the processor has them. Decided once.
#![allow(unsafe_code, reason = "calls of functions that need features of the processor, which were asked for")]

use std::sync::atomic::{AtomicU8, Ordering};

use super::limbs::Limbs;
use super::{adx, field};

const UNDECIDED: u8 = 0;
const PORTABLE: u8 = 1;
const ADX: u8 = 2;

static WAY: AtomicU8 = AtomicU8::new(UNDECIDED);

#[inline(always)]
fn has_adx() -> bool {
    match WAY.load(Ordering::Relaxed) {
        ADX => true,
        PORTABLE => false,
        _ => decide(),
    }
}

#[cold]
#[inline(never)]
fn decide() -> bool {
    let found = is_x86_feature_detected!("adx") && is_x86_feature_detected!("bmi2");
    WAY.store(if found { ADX } else { PORTABLE }, Ordering::Relaxed);
    found
}

#[inline(never)]
fn portable(a: &Limbs, b: &Limbs) -> Limbs {
    field::by_multiplying(a, b)
}

#[inline(always)]
pub(super) fn multiply(a: &Limbs, b: &Limbs) -> Limbs {
    if has_adx() {
        // SAFETY: the features were found.
        unsafe { adx::multiply(a, b) }
    } else {
        portable(a, b)
    }
}

#[inline(always)]
pub(super) fn square(a: &Limbs) -> Limbs {
    if has_adx() {
        // SAFETY: the features were found.
        unsafe { adx::square(a) }
    } else {
        portable(a, a)
    }
}
