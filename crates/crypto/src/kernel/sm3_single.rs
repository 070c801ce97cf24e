//! SM3's compression (GB/T 32905-2016, 5.3) for one long message. States depend on each other, but the message
//! expansion needs none: vectors expand the next blocks between the rounds of the current ones, in free slots.
//! Safety: `hold` emits no instruction; the features the rows need are checked before they are called.
#![allow(unsafe_code, reason = "an empty instruction and calls with checked features, see above")]
#![allow(clippy::many_single_char_names, reason = "the standard's names: A to H")]

use super::sm3::{BLOCK, CONSTANTS};

/// Start of the rows of W': after W_0 to W_67 and twelve rows that are never read.
pub(super) const MIXED: usize = 80;
const ALL: usize = MIXED + 64;

/// W_j and W'_j of several blocks (5.3.2), one block per column.
#[repr(C, align(64))]
pub(super) struct Rows<const LANES: usize>(pub [[u32; LANES]; ALL]);

impl<const LANES: usize> Rows<LANES> {
    const NONE: Self = Self([[0; LANES]; ALL]);
}

/// The same number, hidden from the compiler, which would otherwise add the constant last, on the critical path.
#[inline]
fn hold(mut word: u32) -> u32 {
    // SAFETY: only a comment in the assembly.
    unsafe { std::arch::asm!("/* {0:e} */", inlateout(reg) word, options(pure, nomem, nostack, preserves_flags)) };
    word
}

/// One round (5.3.3); the names rotate instead of the words.
macro_rules! round {
    ($words:ident, $j:expr, $a:ident $b:ident $c:ident $d:ident $e:ident $f:ident $g:ident $h:ident) => {
        let twelve = $a.rotate_left(12);
        let one = hold(twelve.wrapping_add(CONSTANTS[$j])).wrapping_add($e).rotate_left(7);
        let (ff, gg) =
            if $j < 16 { ($a ^ $b ^ $c, $e ^ $f ^ $g) } else { (($a & $b) | ($c & ($a | $b)), (($f ^ $g) & $e) ^ $g) };
        $d = $d.wrapping_add($words[(MIXED + $j) * LANES]).wrapping_add(ff).wrapping_add(one ^ twelve);
        $h = $h.wrapping_add($words[$j * LANES]).wrapping_add(gg).wrapping_add(one);
        $b = $b.rotate_left(9);
        $f = $f.rotate_left(19);
        $h = $h ^ $h.rotate_left(9) ^ $h.rotate_left(17);
    };
}

/// Compresses groups of blocks into a state. `begin` puts W_0 to W_15 of a group into its rows; `row` makes W_(at + 16)
/// and W'_at from the earlier rows.
#[inline(always)]
#[allow(clippy::inline_always, reason = "it has the features of its caller only where it is a part of it")]
pub(super) fn groups<const LANES: usize>(
    state: &mut [u32; 8],
    groups: &[[[u8; BLOCK]; LANES]],
    begin: impl Fn(&mut Rows<LANES>, &[[u8; BLOCK]; LANES]),
    row: impl Fn(&mut Rows<LANES>, usize),
) {
    let Some(first) = groups.first() else { return };
    let mut rows = [Rows::NONE; 2];
    let [now, then] = &mut rows;
    let (mut now, mut then) = (now, then);
    begin(now, first);
    (0..64).for_each(|at| row(now, at));
    for index in 0..groups.len() {
        if let Some(group) = groups.get(index + 1) {
            begin(then, group);
        }
        rounds(state, now, then, &row);
        (now, then) = (then, now);
    }
}

/// The rounds of a group of blocks, interleaved with all rows of the next group.
#[inline(always)]
#[allow(clippy::inline_always, reason = "see above")]
fn rounds<const LANES: usize>(
    state: &mut [u32; 8],
    now: &Rows<LANES>,
    then: &mut Rows<LANES>,
    row: &impl Fn(&mut Rows<LANES>, usize),
) {
    for column in 0..LANES {
        let words = &now.0.as_flattened()[column..];
        // Once here instead of for every word.
        assert!(words.len() > (ALL - 1) * LANES, "a column has all rows");
        let [mut a, mut b, mut c, mut d, mut e, mut f, mut g, mut h] = *state;
        macro_rules! eight {
            ($piece:expr) => {
                round!(words, ($piece * 8), a b c d e f g h);
                round!(words, ($piece * 8 + 1), d a b c h e f g);
                round!(words, ($piece * 8 + 2), c d a b g h e f);
                round!(words, ($piece * 8 + 3), b c d a f g h e);
                round!(words, ($piece * 8 + 4), a b c d e f g h);
                round!(words, ($piece * 8 + 5), d a b c h e f g);
                round!(words, ($piece * 8 + 6), c d a b g h e f);
                round!(words, ($piece * 8 + 7), b c d a f g h e);
                // 64 rows spread over all pieces of all columns.
                if $piece * 8 % LANES == 0 {
                    row(then, (column * 8 + $piece) * 8 / LANES);
                }
            };
        }
        eight!(0);
        eight!(1);
        eight!(2);
        eight!(3);
        eight!(4);
        eight!(5);
        eight!(6);
        eight!(7);
        for (old, new) in state.iter_mut().zip([a, b, c, d, e, f, g, h]) {
            *old ^= new;
        }
    }
}

/// What both vector kernels do in the same way, by the functions of their files: `load`, `store`, `words`, `turned`,
/// `sum` and `chosen`, and four instructions of their vectors.
macro_rules! sm3_vectors {
    ($features:literal, $vector:ident, $zero:ident, $broadcast:ident, $add:ident, $xor:ident) => {
        /// The word that follows 16 words, given `w(0)`, the oldest, to `w(15)` (5.3.2).
        #[inline]
        #[target_feature(enable = $features)]
        fn next(w: impl Fn(usize) -> $vector) -> $vector {
            let mixed = sum(w(0), w(7), turned::<15>(w(13)));
            let mixed = sum(mixed, turned::<15>(mixed), turned::<23>(mixed));
            sum(mixed, turned::<7>(w(3)), w(10))
        }

        /// Compresses one block of each message into its state.
        #[target_feature(enable = $features)]
        pub(super) fn compress(states: &mut States<LANES>, blocks: &[&[u8; BLOCK]; LANES]) {
            let mut w = words(blocks.iter().copied());
            let mut before = [$zero(); 8];
            for (vector, words) in before.iter_mut().zip(states.iter()) {
                *vector = load(words);
            }
            let [mut a, mut b, mut c, mut d, mut e, mut f, mut g, mut h] = before;
            for round in 0..64 {
                let word = w[round % 16];
                if round >= 12 {
                    w[(round + 4) % 16] = next(|at| w[(round + 4 + at) % 16]);
                }
                let mixed = $xor(word, w[(round + 4) % 16]);
                let twelve = turned::<12>(a);
                let key = $add($broadcast(CONSTANTS[round].cast_signed()), e);
                let one = turned::<7>($add(twelve, key));
                let two = $xor(one, twelve);
                let (ff, gg) = chosen(round, [a, b, c], [e, f, g]);
                let first = $add($add(ff, d), $add(two, mixed));
                let second = $add($add(gg, h), $add(one, word));
                let second = sum(second, turned::<9>(second), turned::<17>(second));
                (a, b, c, d) = (first, a, turned::<9>(b), c);
                (e, f, g, h) = (second, e, turned::<19>(f), g);
            }
            for ((words, old), new) in states.iter_mut().zip(before).zip([a, b, c, d, e, f, g, h]) {
                store(words, $xor(old, new));
            }
        }

        #[inline]
        #[target_feature(enable = $features)]
        fn begin(rows: &mut Rows<LANES>, group: &[[u8; BLOCK]; LANES]) {
            for (row, words) in rows.0.iter_mut().zip(words(group.iter())) {
                store(row, words);
            }
        }

        #[inline]
        #[target_feature(enable = $features)]
        fn row(Rows(rows): &mut Rows<LANES>, at: usize) {
            assert!(at < 64, "a block has 64 rounds");
            let next = next(|after| load(&rows[at + after]));
            let mixed = $xor(load(&rows[at]), load(&rows[at + 4]));
            store(&mut rows[at + 16], next);
            store(&mut rows[at + MIXED], mixed);
        }
    };
}
pub(super) use sm3_vectors;
