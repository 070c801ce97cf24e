//! Leaving: at once, once all is verified, or after pausing the capture.

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Leaving {
    Asked,
    /// Quits when everything is verified.
    WhenVerified,
    /// Capture is paused; quits when everything is verified.
    Held,
}
