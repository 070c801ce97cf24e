//! A site with simulated robots, and two registered profiles that join it.

use super::{Authros, Home, Running};

/// The site and its two profiles; it ends on drop.
pub struct Two {
    pub home: Home,
    pub site: Running,
    pub alice: Authros,
    pub alice_address: String,
    pub bob: Authros,
    pub bob_address: String,
}

/// Starts a site with this many robots and registers the profiles.
pub fn two_profiles(robots: u8) -> Two {
    let home = Home::new();
    let site = home.authros().with(&["--robots", &robots.to_string()]).serve(&home);
    let (alice, bob) = (home.profile("alice"), home.profile("bob"));
    let (alice_address, bob_address) = (alice.enrol(), bob.enrol());
    Two { home, site, alice, alice_address, bob, bob_address }
}
