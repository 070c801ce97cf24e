//! How a program without keys begins, which a site starts to speak with the outside: nothing of what was inherited stays
//! open but the pipe, memory is bounded, and signals end it in order.

mod inherited;

use std::fs::File;
use std::os::fd::AsFd;
use std::sync::Arc;
use std::sync::atomic::AtomicBool;

use rustix::process::{Resource, Rlimit, getrlimit, setrlimit};

/// What peers can make a program take is bounded by this, bytes; the site starts anew what ended at its bound.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Memory {
    /// Its whole address space.
    AddressSpace(u64),
    /// What it can write to: for programs with many threads, whose allocator reserves space that it does not use.
    Data(u64),
}

/// A program that has begun.
#[derive(Debug)]
pub struct Begun {
    /// What comes from the site.
    pub from: File,
    /// What goes to it.
    pub to: File,
    /// Set when a signal asks it to end.
    pub stop: Arc<AtomicBool>,
}

/// Closes what was inherited. Only for the very beginning, while nothing of this process is open.
pub fn close_inherited() {
    inherited::close();
}

/// Bounds the memory and takes over pipe and signals.
///
/// # Errors
/// The reason, in words, if there is no pipe, or signals cannot be listened for.
pub fn begin(memory: Memory) -> Result<Begun, &'static str> {
    let stop = Arc::new(AtomicBool::new(false));
    for signal in [signal_hook::consts::SIGTERM, signal_hook::consts::SIGINT, signal_hook::consts::SIGHUP] {
        let registered = signal_hook::flag::register(signal, Arc::clone(&stop));
        registered.map_err(|_| "cannot listen for signals; start it again")?;
    }
    bound(memory);
    let pipes = (std::io::stdin().as_fd().try_clone_to_owned(), std::io::stdout().as_fd().try_clone_to_owned());
    let (Ok(from), Ok(to)) = pipes else { return Err("its input or output is closed; authros has to start it") };
    Ok(Begun { from: File::from(from), to: File::from(to), stop })
}

/// A limit that cannot be set is no reason not to work.
fn bound(memory: Memory) {
    let (resource, wanted) = match memory {
        Memory::AddressSpace(most) => (Resource::As, most),
        Memory::Data(most) => (Resource::Data, most),
    };
    let most = getrlimit(resource).maximum.map_or(wanted, |maximum| maximum.min(wanted));
    let _ = setrlimit(resource, Rlimit { current: Some(most), maximum: Some(most) });
    let _ = setrlimit(Resource::Core, Rlimit { current: Some(0), maximum: Some(0) });
}
