//! A time stamp authority made with openssl alone: keys, certificates and answers.

use std::path::Path;
use std::process::{Command, Stdio};

use crate::time::{Certificate, Request, token_of};

const SETTINGS: &str = "[req]\ndistinguished_name = dn\nprompt = no\n[dn]\nCN = unused\n\
    [ca]\nbasicConstraints = critical,CA:true\nkeyUsage = critical,keyCertSign,cRLSign\n\
    [stamps]\nbasicConstraints = CA:false\nkeyUsage = critical,digitalSignature\nextendedKeyUsage = critical,timeStamping\n\
    [plain]\nbasicConstraints = CA:false\nkeyUsage = critical,digitalSignature\n\
    [loose]\nextendedKeyUsage = timeStamping\n\
    [both]\nextendedKeyUsage = critical,timeStamping,codeSigning\n\
    [names]\nbasicConstraints = critical,CA:true\nkeyUsage = critical,keyCertSign\n\
    nameConstraints = critical,permitted;DNS:example.org\n\
    [odd]\nextendedKeyUsage = critical,timeStamping\n1.2.3.4 = critical,DER:0500\n\
    [sha256]\nserial = ./serial\ndefault_policy = 1.2.3.4.1\ndigests = sha256,sha512\nsigner_digest = sha256\n\
    accuracy = secs:1, millisecs:500\ness_cert_id_alg = sha256\n\
    [sha384]\nserial = ./serial\ndefault_policy = 1.2.3.4.1\ndigests = sha256\nsigner_digest = sha384\ness_cert_id_alg = sha384\n\
    [sha1]\nserial = ./serial\ndefault_policy = 1.2.3.4.1\ndigests = sha256\nsigner_digest = sha512\ness_cert_id_alg = sha1\n";

/// Signs any content as CMS, with the named certificate.
const SIGN: &str = "cms -sign -binary -nodetach -econtent_type 1.2.840.113549.1.9.16.1.4 -nosmimecap -outform DER";

pub const RSA: &str = "-algorithm RSA -pkeyopt rsa_keygen_bits:2048";
pub const RSA_PSS: &str = "-algorithm RSA-PSS -pkeyopt rsa_keygen_bits:2048";
pub const P256: &str = "-algorithm EC -pkeyopt ec_paramgen_curve:P-256";
pub const P384: &str = "-algorithm EC -pkeyopt ec_paramgen_curve:P-384";

pub struct Authority {
    folder: tempfile::TempDir,
}

impl Authority {
    /// With a root named `root`; `None` if there is no openssl.
    pub fn new() -> Option<Self> {
        let known = Command::new("openssl").arg("version").stdout(Stdio::null()).status();
        if !known.is_ok_and(|status| status.success()) {
            return None;
        }
        let authority = Self { folder: tempfile::tempdir().expect("a folder") };
        authority.write("settings", SETTINGS.as_bytes());
        authority.write("serial", b"01\n");
        authority.root("root", P384, "the root");
        Some(authority)
    }

    pub fn write(&self, name: &str, bytes: &[u8]) {
        std::fs::write(self.folder.path().join(name), bytes).expect("written");
    }

    pub fn read(&self, name: &str) -> Vec<u8> {
        std::fs::read(self.folder.path().join(name)).expect(name)
    }

    fn try_openssl(&self, line: &str, subject: Option<&str>) -> std::process::Output {
        let mut command = Command::new("openssl");
        command.args(line.split_whitespace()).current_dir(self.folder.path()).stdin(Stdio::null());
        subject.into_iter().for_each(|subject| {
            command.args(["-subj", &format!("/CN={subject}")]);
        });
        command.env("OPENSSL_CONF", self.folder.path().join("settings")).output().expect("openssl")
    }

    pub fn openssl(&self, line: &str) -> Vec<u8> {
        let done = self.try_openssl(line, None);
        assert!(done.status.success(), "openssl {line}: {}", String::from_utf8_lossy(&done.stderr));
        done.stdout
    }

    /// Whether openssl takes a token for a stamp over this imprint, with the named certificate as its only pin.
    pub fn accepts(&self, token: &[u8], imprint: [u8; 32], pin: &str) -> bool {
        self.write("token", token);
        let imprint = authros_model::bytes::hex(&imprint);
        let line = format!("ts -verify -digest {imprint} -token_in -in token -CAfile {pin}.pem -partial_chain");
        self.try_openssl(&line, None).status.success()
    }

    fn with_subject(&self, line: &str, subject: &str) {
        let done = self.try_openssl(line, Some(subject));
        assert!(done.status.success(), "openssl {line}: {}", String::from_utf8_lossy(&done.stderr));
    }

    /// A root of its own.
    pub fn root(&self, name: &str, key: &str, subject: &str) {
        self.openssl(&format!("genpkey {key} -out {name}.key"));
        let line = format!("req -x509 -new -key {name}.key -days 30 -config settings -extensions ca -out {name}.pem");
        self.with_subject(&line, subject);
    }

    /// A certificate issued by another one's key, with these extensions; `more` is passed to the issuer.
    pub fn issue(&self, (name, key): (&str, &str), by: &str, extensions: &str, more: &str) {
        self.openssl(&format!("genpkey {key} -out {name}.key"));
        self.with_subject(&format!("req -new -key {name}.key -config settings -out {name}.csr"), name);
        let serial: u32 = name.bytes().fold(17, |sum, byte| sum * 31 % 1_000_003 + u32::from(byte));
        self.openssl(&format!(
            "x509 -req -in {name}.csr -CA {by}.pem -CAkey {by}.key -set_serial {serial} -days 20 -extfile settings \
             -extensions {extensions} {more} -out {name}.pem"
        ));
    }

    pub fn pem(&self, name: &str) -> String {
        String::from_utf8(self.read(&format!("{name}.pem"))).expect("text")
    }

    pub fn certificate(&self, name: &str) -> Certificate {
        Certificate::from_pem(&self.pem(name)).expect("a certificate")
    }

    /// The answer to a request of our own.
    pub fn answer(&self, request: &[u8], signer: &str, section: &str, more: &str) -> Vec<u8> {
        self.write("request", request);
        self.openssl(&format!(
            "ts -reply -queryfile request -config settings -section {section} -signer {signer}.pem -inkey {signer}.key \
             {more} -out answer"
        ));
        self.read("answer")
    }

    /// A token over an imprint.
    pub fn token(&self, imprint: [u8; 32], signer: &str, section: &str) -> Vec<u8> {
        let request = Request { imprint, nonce: [7; 16] };
        let answer = self.answer(&request.encode(), signer, section, "");
        token_of(&answer).expect("granted").to_vec()
    }

    /// A token over this content, by the named certificate, in the given way.
    pub fn signed(&self, content: &[u8], signer: &str, more: &str) -> Vec<u8> {
        self.write("content", content);
        self.openssl(&format!("{SIGN} -signer {signer}.pem -inkey {signer}.key {more} -in content -out signed"));
        self.read("signed")
    }
}

impl AsRef<Path> for Authority {
    fn as_ref(&self) -> &Path {
        self.folder.path()
    }
}
