//! How many arenas the allocator of a running site has: each keeps what was freed in it.

use std::fs;

use crate::support::{Authros, Home, skipped};

/// glibc's heaps beside the main one begin at multiples of this, on 64-bit machines.
const HEAP: u64 = 64 << 20;

/// The heaps that glibc's arenas beside the main one have in a process: readable memory at such a multiple, with the
/// rest of the heap reserved behind it. `None` if this user may not look.
fn heaps(process: u32) -> Option<usize> {
    let maps = fs::read_to_string(format!("/proc/{process}/maps")).ok().filter(|maps| !maps.is_empty())?;
    let parts: Vec<(u64, u64, &str)> = maps
        .lines()
        .filter_map(|line| {
            let mut words = line.split_whitespace();
            let (from, to) = words.next()?.split_once('-')?;
            let ends = (u64::from_str_radix(from, 16).ok()?, u64::from_str_radix(to, 16).ok()?);
            Some((ends.0, ends.1, words.next()?))
        })
        .collect();
    let is_heap = |pair: &&[(u64, u64, &str)]| {
        let (first, second) = (pair[0], pair[1]);
        first.2 == "rw-p"
            && first.0 % HEAP == 0
            && first.1 == second.0
            && second.2 == "---p"
            && second.1 == first.0 + HEAP
    };
    Some(parts.windows(2).filter(is_heap).count())
}

fn heaps_of(authros: &Authros, home: &Home) -> Option<usize> {
    let site = authros.with(&["--robots", "2"]).serve(home);
    heaps(site.id())
}

#[test]
fn a_site_asks_the_allocator_for_two_arenas_unless_somebody_else_does() {
    let (ours, others) = (Home::new(), Home::new());
    let asked = heaps_of(&others.authros().with_variable("MALLOC_ARENA_MAX", "64"), &others);
    let (Some(few), Some(many)) = (heaps_of(&ours.authros(), &ours), asked) else {
        skipped!("this user may not read the map of a process that holds keys")
    };
    assert!(many > 1, "64 were asked for, and a site has more threads than that makes one of: {many}");
    assert!(few <= 1, "beside the main arena there is one more: {few}");
}
