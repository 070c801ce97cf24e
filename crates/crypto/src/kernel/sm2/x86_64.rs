//! Arithmetic modulo the SM2 prime in assembly: sums by carries, products by BMI2 and ADX. All of it is straight-line
//! code: no branches, no address that depends on a number.
#![allow(unsafe_code, reason = "instructions that the compiler does not choose by itself")]

use std::arch::asm;

use super::field::MODULUS;
use super::limbs::Limbs;

/// One step of the reduction: `$low` is the lowest limb m, and (`$a`, `$b`, `$c`, `$low`) becomes the number with m p
/// added, shifted down one limb. As p is -1 modulo 2^64, m itself is the factor, and m p is made by shifts.
macro_rules! step {
    ($low:literal, $a:literal, $b:literal, $c:literal) => {
        concat!(
            concat!("mov {lo}, {", $low, "}\n mov {hi}, {", $low, "}\n shl {lo}, 32\n shr {hi}, 32\n"),
            concat!("add {", $a, "}, {", $low, "}\n adc {", $b, "}, 0\n adc {", $c, "}, 0\n adc {", $low, "}, 0\n"),
            concat!("sub {", $a, "}, {lo}\n sbb {", $b, "}, {hi}\n"),
            concat!(" sbb {", $c, "}, {lo}\n sbb {", $low, "}, {hi}\n"),
        )
    };
}

/// Reduces t0 to t7, below p 2^256, to t4 to t7, below p.
macro_rules! reduction {
    () => {
        concat!(
            step!("t0", "t1", "t2", "t3"),
            step!("t1", "t2", "t3", "t0"),
            step!("t2", "t3", "t0", "t1"),
            step!("t3", "t0", "t1", "t2"),
            "add {t0}, {t4}\n adc {t1}, {t5}\n adc {t2}, {t6}\n adc {t3}, {t7}\n",
            "sbb rdx, rdx\n",
            "mov {t4}, {t0}\n mov {t5}, {t1}\n mov {t6}, {t2}\n mov {t7}, {t3}\n",
            "mov {lo}, 0xffffffff00000000\n mov {hi}, 0xfffffffeffffffff\n",
            "sub {t4}, -1\n sbb {t5}, {lo}\n sbb {t6}, -1\n sbb {t7}, {hi}\n sbb rdx, 0\n",
            // The carry is the borrow out of everything but the carry of the sum: rdx was -1 with one, and 0 without.
            "cmovc {t4}, {t0}\n cmovc {t5}, {t1}\n cmovc {t6}, {t2}\n cmovc {t7}, {t3}\n",
        )
    };
}

/// One row of the product: adds a times a limb of b to `$t0` to `$t3` and opens `$t4`.
macro_rules! row {
    ($limb:literal, $t0:literal, $t1:literal, $t2:literal, $t3:literal, $t4:literal) => {
        concat!(
            concat!("mov rdx, [{b} + ", $limb, "]\n xor {", $t4, ":e}, {", $t4, ":e}\n"),
            concat!("mulx {hi}, {lo}, [{a}]\n adcx {", $t0, "}, {lo}\n adox {", $t1, "}, {hi}\n"),
            concat!("mulx {hi}, {lo}, [{a} + 8]\n adcx {", $t1, "}, {lo}\n adox {", $t2, "}, {hi}\n"),
            concat!("mulx {hi}, {lo}, [{a} + 16]\n adcx {", $t2, "}, {lo}\n adox {", $t3, "}, {hi}\n"),
            concat!("mulx {hi}, {lo}, [{a} + 24]\n adcx {", $t3, "}, {lo}\n adox {", $t4, "}, {hi}\n"),
            concat!("adc {", $t4, "}, 0\n"),
        )
    };
}

/// `a b / 2^256` modulo p, for numbers below p.
///
/// # Safety
/// The processor must have BMI2 and ADX.
#[inline]
pub(super) unsafe fn multiply(a: &Limbs, b: &Limbs) -> Limbs {
    let mut out = [0; 4];
    // SAFETY: the caller guarantees the instructions; only the eight limbs at a and b are read, nothing is written to
    // memory, and every register that changes is an output.
    unsafe {
        asm!(
            "mov rdx, [{b}]",
            "mulx {t1}, {t0}, [{a}]",
            "mulx {t2}, {lo}, [{a} + 8]",
            "add {t1}, {lo}",
            "mulx {t3}, {lo}, [{a} + 16]",
            "adc {t2}, {lo}",
            "mulx {t4}, {lo}, [{a} + 24]",
            "adc {t3}, {lo}",
            "adc {t4}, 0",
            row!("8", "t1", "t2", "t3", "t4", "t5"),
            row!("16", "t2", "t3", "t4", "t5", "t6"),
            row!("24", "t3", "t4", "t5", "t6", "t7"),
            reduction!(),
            a = in(reg) a.as_ptr(),
            b = in(reg) b.as_ptr(),
            lo = out(reg) _,
            hi = out(reg) _,
            t0 = out(reg) _,
            t1 = out(reg) _,
            t2 = out(reg) _,
            t3 = out(reg) _,
            t4 = out(reg) out[0],
            t5 = out(reg) out[1],
            t6 = out(reg) out[2],
            t7 = out(reg) out[3],
            out("rdx") _,
            options(pure, readonly, nostack),
        );
    }
    out
}

/// `a a / 2^256` modulo p, for a number below p.
///
/// # Safety
/// The processor must have BMI2 and ADX.
#[inline]
pub(super) unsafe fn square(a: &Limbs) -> Limbs {
    let mut out = [0; 4];
    // SAFETY: as for the product; only the four limbs at a are read.
    unsafe {
        asm!(
            "mov rdx, [{a}]",
            "mulx {t2}, {t1}, [{a} + 8]",
            "mulx {t3}, {lo}, [{a} + 16]",
            "add {t2}, {lo}",
            "mulx {t4}, {lo}, [{a} + 24]",
            "adc {t3}, {lo}",
            "adc {t4}, 0",
            "mov rdx, [{a} + 8]",
            "mulx {hi}, {lo}, [{a} + 16]",
            "mulx {t5}, {t0}, [{a} + 24]",
            "add {t3}, {lo}",
            "adc {t4}, {hi}",
            "adc {t5}, 0",
            "mov rdx, [{a} + 16]",
            "mulx {t6}, {lo}, [{a} + 24]",
            "add {t4}, {t0}",
            "adc {t5}, {lo}",
            "adc {t6}, 0",
            "xor {t7:e}, {t7:e}",
            "add {t1}, {t1}",
            "adc {t2}, {t2}",
            "adc {t3}, {t3}",
            "adc {t4}, {t4}",
            "adc {t5}, {t5}",
            "adc {t6}, {t6}",
            "adc {t7}, {t7}",
            "mov rdx, [{a}]",
            "mulx {lo}, {t0}, rdx",
            "mov rdx, [{a} + 8]",
            "add {t1}, {lo}",
            "mulx {hi}, {lo}, rdx",
            "adc {t2}, {lo}",
            "adc {t3}, {hi}",
            "mov rdx, [{a} + 16]",
            "mulx {hi}, {lo}, rdx",
            "adc {t4}, {lo}",
            "adc {t5}, {hi}",
            "mov rdx, [{a} + 24]",
            "mulx {hi}, {lo}, rdx",
            "adc {t6}, {lo}",
            "adc {t7}, {hi}",
            reduction!(),
            a = in(reg) a.as_ptr(),
            lo = out(reg) _,
            hi = out(reg) _,
            t0 = out(reg) _,
            t1 = out(reg) _,
            t2 = out(reg) _,
            t3 = out(reg) _,
            t4 = out(reg) out[0],
            t5 = out(reg) out[1],
            t6 = out(reg) out[2],
            t7 = out(reg) out[3],
            out("rdx") _,
            options(pure, readonly, nostack),
        );
    }
    out
}

/// `a + b` modulo p, for numbers below p.
#[inline(always)]
pub(super) fn add(a: &Limbs, b: &Limbs) -> Limbs {
    let mut out = [0; 4];
    // SAFETY: every x86-64 processor has these instructions; no memory is touched, and every register that changes is
    // an output.
    unsafe {
        asm!(
            "add {a0}, {b0}",
            "adc {a1}, {b1}",
            "adc {a2}, {b2}",
            "adc {a3}, {b3}",
            "sbb {carry}, {carry}",
            "mov {b0}, {a0}",
            "mov {b1}, {a1}",
            "mov {b2}, {a2}",
            "mov {b3}, {a3}",
            "sub {a0}, -1",
            "sbb {a1}, {second}",
            "sbb {a2}, -1",
            "sbb {a3}, {fourth}",
            "sbb {carry}, 0",
            // As in the reduction: below p and without a carry it stays unchanged.
            "cmovc {a0}, {b0}",
            "cmovc {a1}, {b1}",
            "cmovc {a2}, {b2}",
            "cmovc {a3}, {b3}",
            a0 = inout(reg) a[0] => out[0],
            a1 = inout(reg) a[1] => out[1],
            a2 = inout(reg) a[2] => out[2],
            a3 = inout(reg) a[3] => out[3],
            b0 = inout(reg) b[0] => _,
            b1 = inout(reg) b[1] => _,
            b2 = inout(reg) b[2] => _,
            b3 = inout(reg) b[3] => _,
            carry = out(reg) _,
            second = in(reg) MODULUS[1],
            fourth = in(reg) MODULUS[3],
            options(pure, nomem, nostack),
        );
    }
    out
}

/// Adds p to `a0` to `a3` if `first` is all ones, nothing if it is zero; the carry is left in the flag.
macro_rules! add_masked_modulus {
    () => {
        "mov {second}, {first}
         mov {fourth}, {first}
         shl {second}, 32
         btr {fourth}, 32
         add {a0}, {first}
         adc {a1}, {second}
         adc {a2}, {first}
         adc {a3}, {fourth}"
    };
}

/// `a / 2` modulo p, for a number below p.
#[inline(always)]
pub(super) fn halve(a: &Limbs) -> Limbs {
    let mut out = [0; 4];
    // SAFETY: as for the sum.
    unsafe {
        asm!(
            // p if the number is odd, otherwise zero.
            "mov {first}, {a0}",
            "and {first}, 1",
            "neg {first}",
            add_masked_modulus!(),
            "sbb {first}, {first}",
            "shrd {a0}, {a1}, 1",
            "shrd {a1}, {a2}, 1",
            "shrd {a2}, {a3}, 1",
            "shrd {a3}, {first}, 1",
            a0 = inout(reg) a[0] => out[0],
            a1 = inout(reg) a[1] => out[1],
            a2 = inout(reg) a[2] => out[2],
            a3 = inout(reg) a[3] => out[3],
            first = out(reg) _,
            second = out(reg) _,
            fourth = out(reg) _,
            options(pure, nomem, nostack),
        );
    }
    out
}

/// `a - b` modulo p, for numbers below p.
#[inline(always)]
pub(super) fn subtract(a: &Limbs, b: &Limbs) -> Limbs {
    let mut out = [0; 4];
    // SAFETY: as for the sum.
    unsafe {
        asm!(
            "sub {a0}, {b0}",
            "sbb {a1}, {b1}",
            "sbb {a2}, {b2}",
            "sbb {a3}, {b3}",
            // p if that borrowed, otherwise zero.
            "sbb {first}, {first}",
            add_masked_modulus!(),
            a0 = inout(reg) a[0] => out[0],
            a1 = inout(reg) a[1] => out[1],
            a2 = inout(reg) a[2] => out[2],
            a3 = inout(reg) a[3] => out[3],
            b0 = in(reg) b[0],
            b1 = in(reg) b[1],
            b2 = in(reg) b[2],
            b3 = in(reg) b[3],
            first = out(reg) _,
            second = out(reg) _,
            fourth = out(reg) _,
            options(pure, nomem, nostack),
        );
    }
    out
}
