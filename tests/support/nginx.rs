//! nginx before a node, with TLS: a good certificate, and bad ones.

use std::path::{Path, PathBuf};
use std::process::Command;

use tempfile::TempDir;

use super::process::Running;
use super::{free_port, system_program, wait_until};

/// The user and the password that it wants.
pub const USER: &str = "op";
/// Its characters need escapes in a URL.
pub const PASSWORD: &str = "geheim:@/1";
/// The same, escaped.
pub const ESCAPED: &str = "geheim%3A%40%2F1";
/// The folder of the node's path that is a secret.
pub const KEY: &str = "K3YINTHEPATH";

/// A server in front of a node.
#[derive(Debug)]
pub struct Nginx {
    _server: Running,
    ports: [u16; 4],
    folder: TempDir,
}

/// Which of its ports.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Certificate {
    /// Of the authority in [`Nginx::roots`], for 127.0.0.1.
    Good,
    /// Of no authority.
    SelfSigned,
    /// It ended years ago.
    Expired,
    /// For another name.
    OtherName,
}

const EACH: [(Certificate, &str); 4] = [
    (Certificate::Good, "good"),
    (Certificate::SelfSigned, "own"),
    (Certificate::Expired, "expired"),
    (Certificate::OtherName, "other"),
];

impl Nginx {
    /// Starts one before a node's port; the reason if it cannot be had.
    pub fn start(node: u16) -> Result<Self, &'static str> {
        let program = system_program("nginx").ok_or("no nginx")?;
        system_program("openssl").ok_or("no openssl")?;
        let faketime = system_program("faketime").ok_or("no faketime")?;
        let folder = tempfile::Builder::new().prefix("nginx").tempdir().expect("a temporary directory");
        certificates(folder.path(), &faketime);
        // Another process may take a free port first: then others are tried.
        for _ in 0..5 {
            let ports = [free_port(), free_port(), free_port(), free_port()];
            std::fs::write(folder.path().join("nginx.conf"), settings(&ports, node)).expect("written");
            let mut command = Command::new(&program);
            command.arg("-p").arg(folder.path()).args(["-c", "nginx.conf", "-e", "stderr"]);
            let mut server = Running::start(command);
            let is_up = wait_until(30, "nginx is up or has ended", || {
                let is_up = std::net::TcpStream::connect(("127.0.0.1", ports[0])).is_ok();
                (is_up || !server.is_running()).then_some(is_up)
            });
            if is_up {
                return Ok(Self { _server: server, ports, folder });
            }
        }
        panic!("nginx finds no ports to listen on");
    }

    /// HOST:PORT.
    pub fn at(&self, certificate: Certificate) -> String {
        let index = EACH.iter().position(|(each, _)| *each == certificate).expect("one of them");
        format!("127.0.0.1:{}", self.ports[index])
    }

    /// The node's URL with everything that it wants.
    pub fn url(&self) -> String {
        format!("https://{USER}:{ESCAPED}@{}/{KEY}/", self.at(Certificate::Good))
    }

    /// The authority's certificate.
    pub fn roots(&self) -> PathBuf {
        self.folder.path().join("ca.pem")
    }
}

fn settings(ports: &[u16; 4], node: u16) -> String {
    let server = |(port, (_, name)): (&u16, &(Certificate, &str))| {
        format!(
            "server {{ listen 127.0.0.1:{port} ssl; ssl_certificate {name}.pem; ssl_certificate_key {name}.key;\n\
             location /{KEY}/ {{ auth_basic node; auth_basic_user_file users; proxy_pass http://127.0.0.1:{node}/; }}\n\
             location / {{ return 404; }} }}\n"
        )
    };
    let servers: String = ports.iter().zip(&EACH).map(server).collect();
    let places: String = ["client_body", "proxy", "fastcgi", "uwsgi", "scgi"]
        .iter()
        .map(|name| format!("{name}_temp_path .;\n"))
        .collect();
    format!(
        "daemon off;\nmaster_process off;\npid nginx.pid;\nevents {{}}\nhttp {{\naccess_log off;\n{places}\
         client_max_body_size 8m;\n{servers}}}\n"
    )
}

/// Writes an authority (`ca.pem`) and certificates with their keys into a folder: `good`, `own`, `expired`, `other`.
pub fn certificates(folder: &Path, faketime: &Path) {
    let openssl = |program: &Path, words: &[&str]| {
        let outcome = Command::new(program).args(words).current_dir(folder).output().expect("openssl");
        assert!(outcome.status.success(), "{words:?}: {}", String::from_utf8_lossy(&outcome.stderr));
        String::from_utf8(outcome.stdout).expect("text")
    };
    let plain = |line: &str| openssl(Path::new("openssl"), &line.split(' ').collect::<Vec<_>>());
    for (name, address) in [("here", "127.0.0.1"), ("there", "192.0.2.1")] {
        let text = format!("subjectAltName=IP:{address}\nbasicConstraints=critical,CA:FALSE\n");
        std::fs::write(folder.join(name), text).expect("written");
    }
    plain("req -x509 -newkey rsa:2048 -nodes -days 2 -subj /CN=yard -keyout ca.key -out ca.pem");
    plain("req -x509 -newkey rsa:2048 -nodes -days 2 -subj /CN=own -keyout own.key -out own.pem");
    for (name, extensions, past) in [("good", "here", false), ("expired", "here", true), ("other", "there", false)] {
        plain(&format!("req -newkey rsa:2048 -nodes -subj /CN={name} -keyout {name}.key -out {name}.csr"));
        let sign = format!(
            "x509 -req -in {name}.csr -CA ca.pem -CAkey ca.key -CAcreateserial -days 2 -extfile {extensions} -out {name}.pem"
        );
        let words: Vec<&str> = sign.split(' ').collect();
        if past {
            openssl(faketime, &[&["2020-01-01 00:00:00", "openssl"], &words[..]].concat());
        } else {
            openssl(Path::new("openssl"), &words);
        }
    }
    let hash = plain(&format!("passwd -apr1 {PASSWORD}"));
    std::fs::write(folder.join("users"), format!("{USER}:{hash}")).expect("written");
}
