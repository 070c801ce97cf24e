//! Whom TLS trusts, and plain words for what a server or its certificate says. Shows no path or password.

use std::error::Error;
use std::path::{Path, PathBuf};
use std::sync::Arc;

use authros_model::{Timestamp, clean};
use tokio_rustls::rustls::crypto::ring;
use tokio_rustls::rustls::pki_types::CertificateDer;
use tokio_rustls::rustls::pki_types::pem::PemObject as _;
use tokio_rustls::rustls::{self, CertificateError, ClientConfig, RootCertStore};
use url::Url;

const TRUSTED: [&str; 3] =
    ["/etc/ssl/certs/ca-certificates.crt", "/etc/pki/tls/certs/ca-bundle.crt", "/etc/ssl/cert.pem"];
/// In bytes; distributions' have about 250 kB.
const LONGEST_ROOTS: u64 = 16 << 20;

/// Trusts the authorities in a PEM file, or those of this machine (`SSL_CERT_FILE`, or the distribution's file).
pub fn tls(file: Option<&Path>) -> Result<ClientConfig, String> {
    let named = std::env::var_os("SSL_CERT_FILE").map(PathBuf::from);
    let of_machine = || named.or_else(|| TRUSTED.iter().map(PathBuf::from).find(|path| path.is_file()));
    let path = file
        .map(Path::to_owned)
        .or_else(of_machine)
        .ok_or("this machine has no certificate authorities for https; install ca-certificates")?;
    let shown = clean(&path.display().to_string(), 200);
    let unusable = |why: String| format!("{shown} cannot be used for https: {why}");
    let length = std::fs::metadata(&path).map_err(|error| unusable(error.to_string()))?.len();
    if length > LONGEST_ROOTS {
        return Err(unusable("it is too long for a file of certificates".to_owned()));
    }
    let bytes = std::fs::read(&path).map_err(|error| unusable(error.to_string()))?;
    let found = CertificateDer::pem_slice_iter(&bytes).collect::<Result<Vec<_>, _>>();
    let found = found.map_err(|error| unusable(clean(&error.to_string(), 120)))?;
    let mut roots = RootCertStore::empty();
    let (usable, _) = roots.add_parsable_certificates(found);
    if usable == 0 {
        return Err(unusable("it contains no PEM certificate".to_owned()));
    }
    let config = ClientConfig::builder_with_provider(Arc::new(ring::default_provider()));
    let config = config.with_safe_default_protocol_versions().map_err(|error| unusable(error.to_string()))?;
    Ok(config.with_root_certificates(roots).with_no_client_auth())
}

#[derive(Debug, Clone, PartialEq, Eq)]
pub struct TlsFault {
    /// A predicate of the server.
    pub reason: String,
    pub advice: String,
}

/// `roots`: the setting that names authorities.
pub fn tls_fault(error: &(dyn Error + 'static), roots: &str) -> Option<TlsFault> {
    let fault = |reason: &str, advice: String| Some(TlsFault { reason: reason.to_owned(), advice });
    let rustls::Error::InvalidCertificate(certificate) = rustls_error(error)? else {
        let reason = format!("does not speak TLS as expected ({})", clean(&rustls_error(error)?.to_string(), 120));
        return fault(&reason, "check the port, and whether it serves TLS at all".to_owned());
    };
    let renew = || "have it renewed, and check this machine's clock".to_owned();
    match certificate {
        CertificateError::UnknownIssuer => fault(
            "shows a certificate of an authority that is not trusted here",
            format!("set {roots} to a PEM file with the authority that issued it"),
        ),
        CertificateError::Expired => fault("shows a certificate that has expired", renew()),
        CertificateError::ExpiredContext { not_after, .. } => {
            let end = Timestamp::from_seconds(not_after.as_secs());
            fault(&format!("shows a certificate that expired at {end}"), renew())
        }
        CertificateError::NotValidYet | CertificateError::NotValidYetContext { .. } => {
            fault("shows a certificate that is not valid yet", "check the clocks of both machines".to_owned())
        }
        CertificateError::NotValidForName | CertificateError::NotValidForNameContext { .. } => fault(
            "shows a certificate for another name than the one in its URL",
            "use the name in the certificate, or get a certificate for this name".to_owned(),
        ),
        // Self-signed ones are, unless their maker took care.
        other if other.to_string().contains("CaUsedAsEndEntity") => fault(
            "shows a certificate of an authority as its own, which proves no server",
            format!("have a certificate issued (CA:FALSE), and set {roots} to a PEM file with the authority"),
        ),
        other => fault(
            &format!("shows a certificate that cannot be accepted ({})", clean(&other.to_string(), 120)),
            format!("have another certificate issued, by an authority in {roots}"),
        ),
    }
}

/// An I/O error wraps what TLS found without naming it as its source.
fn rustls_error<'a>(error: &'a (dyn Error + 'static)) -> Option<&'a rustls::Error> {
    let mut cause = Some(error);
    while let Some(found) = cause {
        if let Some(fault) = found.downcast_ref::<rustls::Error>() {
            return Some(fault);
        }
        let inner = found.downcast_ref::<std::io::Error>().and_then(std::io::Error::get_ref);
        cause = inner.map(|inner| inner as &(dyn Error + 'static)).or_else(|| found.source());
    }
    None
}

/// "connection refused" rather than three layers around it; does not contain the URL.
pub fn innermost(error: &(dyn Error + 'static)) -> String {
    let mut cause = error;
    while let Some(deeper) = cause.source() {
        cause = deeper;
    }
    clean(&cause.to_string(), 160)
}

/// Where a redirect leads, without secrets. `asked` is the URL that answered.
pub fn redirected(asked: &Url, location: Option<&str>) -> String {
    let Some(place) = location.and_then(|location| asked.join(location).ok()) else {
        return "a place that it does not name".to_owned();
    };
    let slash = |url: &Url| url.path().trim_end_matches('/').to_owned();
    if place.origin() != asked.origin() {
        let host = clean(place.host_str().unwrap_or_default(), 100);
        let port = place.port().map(|port| format!(":{port}")).unwrap_or_default();
        let scheme = clean(place.scheme(), 20);
        return format!("{scheme}://{host}{port}{}", if place.path() == "/" { "" } else { "/…" });
    }
    match (slash(&place) == slash(asked), place.path().ends_with('/')) {
        (true, true) => "the same address with a slash at its end".to_owned(),
        (true, false) => "the same address without the slash at its end".to_owned(),
        (false, _) => "another path of the same server".to_owned(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_redirect_is_named_without_its_path() {
        let asked = Url::parse("https://host:1/hook/SECRET").expect("a URL");
        for (location, expected) in [
            (Some("http://host:1/hook/SECRET"), "http://host:1/…"),
            (Some("https://other.example/hook/SECRET2"), "https://other.example/…"),
            (Some("https://me:pw@other.example"), "https://other.example"),
            (Some("/hook/SECRET/"), "the same address with a slash at its end"),
            (Some("/login?next=SECRET"), "another path of the same server"),
            (Some("http://[::"), "a place that it does not name"),
            (None, "a place that it does not name"),
        ] {
            assert_eq!(redirected(&asked, location), expected, "{location:?}");
        }
    }

    #[test]
    fn a_certificate_is_found_behind_the_errors_around_it() {
        let tls = |error: CertificateError| rustls::Error::InvalidCertificate(error);
        let around = |error: rustls::Error| std::io::Error::other(std::io::Error::other(error));
        let fault = |error| tls_fault(&around(tls(error)), "chain.roots").expect("a fault of TLS");
        assert!(fault(CertificateError::UnknownIssuer).advice.contains("chain.roots"));
        assert!(fault(CertificateError::Expired).reason.contains("expired"));
        assert!(fault(CertificateError::NotValidForName).reason.contains("another name"));
        assert_eq!(tls_fault(&std::io::Error::other("refused"), "chain.roots"), None);
    }

    #[test]
    fn a_file_without_certificates_is_named() {
        let file = tempfile::NamedTempFile::new().expect("a file");
        let name = file.path().display().to_string();
        let why = tls(Some(file.path())).expect_err("empty");
        assert!(why.contains(&name) && why.contains("no PEM certificate"), "{why}");
        assert!(tls(Some(Path::new("/nowhere/roots.pem"))).expect_err("missing").contains("/nowhere/roots.pem"));
    }
}
