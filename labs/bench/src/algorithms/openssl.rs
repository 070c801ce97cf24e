//! What the `openssl` command says of itself: `openssl speed`, a mean over a second for each piece of work.

use std::process::{Command, Stdio};

use super::{Algorithm, LARGEST, SIGNED};
use crate::spread::number;
use authros_model::clean;

/// Bytes of a message.
const SIZES: [usize; 2] = [8192, LARGEST];

/// Work, by whom, bytes of a message, and microseconds for it.
type Mean = (&'static str, &'static str, usize, f64);

/// Its version and its means, or why there are none.
pub(super) fn measure(algorithm: Algorithm) -> Result<(String, Vec<Mean>), String> {
    let version = said(&["version"])?;
    let version = clean(version.split('(').next().unwrap_or_default().trim(), 60);
    let mut means = Vec::new();
    match algorithm {
        Algorithm::Sm2 => {
            let said = said(&["speed", "-mr", "-seconds", "1", "sm2"])?;
            let [sign, verify] = rates(&said, "+F7:").and_then(|rates| rates.try_into().ok()).ok_or_else(unread)?;
            means
                .extend([("sign", sign), ("verify", verify)].map(|(work, rate)| (work, "openssl", SIGNED, 1e6 / rate)));
        }
        Algorithm::Sm3 => {
            for bytes in SIZES {
                means.push(("digest", "openssl", bytes, evp(&["-evp", "sm3"], bytes)?));
            }
        }
        Algorithm::Sm4 => {
            for bytes in SIZES {
                means.push(("seal", "openssl-ctr", bytes, evp(&["-evp", "sm4-ctr"], bytes)?));
                means.push(("open", "openssl-ctr", bytes, evp(&["-decrypt", "-evp", "sm4-ctr"], bytes)?));
            }
        }
    }
    Ok((version, means))
}

/// Microseconds for a message of that many bytes.
fn evp(work: &[&str], bytes: usize) -> Result<f64, String> {
    let length = bytes.to_string();
    let said = said(&[&["speed", "-mr", "-seconds", "1", "-bytes", &length], work].concat())?;
    let rates = rates(&said, "+F:").ok_or_else(unread)?;
    rates.first().map(|rate| number(bytes) * 1e6 / rate).ok_or_else(unread)
}

/// The last numbers of the line that begins so: bytes or operations a second.
fn rates(said: &str, begin: &str) -> Option<Vec<f64>> {
    let line = said.lines().find(|line| line.starts_with(begin))?;
    let numbers = line.split(':').skip_while(|part| part.parse::<f64>().is_ok() || part.starts_with('+')).skip(1);
    let numbers: Option<Vec<f64>> = numbers.map(|part| part.trim().parse().ok().filter(|rate| *rate > 0.0)).collect();
    numbers.filter(|numbers| !numbers.is_empty())
}

fn said(arguments: &[&str]) -> Result<String, String> {
    let ran = Command::new("openssl").args(arguments).stdin(Stdio::null()).output();
    let ran = ran.map_err(|error| format!("openssl cannot be run ({error}); install it to include it"))?;
    if ran.status.success() {
        return Ok(String::from_utf8_lossy(&ran.stdout).into_owned());
    }
    let words = String::from_utf8_lossy(&ran.stderr);
    Err(format!("openssl refused ({})", clean(words.lines().next().unwrap_or("no reason given"), 200)))
}

fn unread() -> String {
    "its figures are not understood; OpenSSL 3 is expected".to_owned()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn rates_are_the_numbers_behind_the_name() {
        assert_eq!(rates("+H:8192\n+F:25:sm3:373762068.69\n", "+F:"), Some(vec![373_762_068.69]));
        assert_eq!(rates("+F7:0:256:CurveSM2:3010.5:3370.25\n", "+F7:"), Some(vec![3010.5, 3370.25]));
        for bad in ["", "+F:25:sm3:", "+F:25:sm3:0.00", "+F:25:sm3:x", "+F:"] {
            assert_eq!(rates(bad, "+F:"), None, "{bad}");
        }
    }
}
