//! Which products modulo the SM2 prime are used: those with BMI2 and ADX if the processor has them. Decided once.
#![allow(unsafe_code, reason = "calls of functions that need features of the processor, which were asked for")]

use std::sync::atomic::{AtomicU8, Ordering};

use super::limbs::Limbs;
use super::{field, x86_64};

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

/// Tells the compiler which way to lay out of line.
#[cold]
#[inline(always)]
fn cold() {}

#[inline(always)]
pub(super) fn multiply(a: &Limbs, b: &Limbs) -> Limbs {
    if has_adx() {
        // SAFETY: the features were detected.
        unsafe { x86_64::multiply(a, b) }
    } else {
        cold();
        field::by_multiplying(a, b)
    }
}

#[inline(always)]
pub(super) fn square(a: &Limbs) -> Limbs {
    if has_adx() {
        // SAFETY: the features were detected.
        unsafe { x86_64::square(a) }
    } else {
        cold();
        field::by_squaring(a)
    }
}

/// Runs a closure as on a processor without the features; other threads may do so meanwhile, with the same results.
#[cfg(test)]
pub(super) fn portably<T>(work: impl FnOnce() -> T) -> T {
    let before = WAY.swap(PORTABLE, Ordering::Relaxed);
    let done = work();
    WAY.store(before, Ordering::Relaxed);
    done
}
