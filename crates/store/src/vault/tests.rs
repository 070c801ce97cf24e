//! The vault's tests: what both kinds must do, then what is specific to Redis. Starts a real server if one is
//! installed.

mod server;

use std::collections::BTreeMap;

use super::*;
use crate::model::ErrorKind;
use server::Server;

fn blob(number: u32, length: usize) -> (Digest, Vec<u8>) {
    let mut digest = [0; 32];
    digest[..4].copy_from_slice(&number.to_be_bytes());
    (Digest(digest), number.to_be_bytes().into_iter().cycle().take(length).collect())
}

fn borrowed(blobs: &[(Digest, Vec<u8>)]) -> Vec<(Digest, &[u8])> {
    blobs.iter().map(|(digest, bytes)| (*digest, bytes.as_slice())).collect()
}

fn behaves(vault: &dyn Vault) {
    let blobs: Vec<_> = (0..40).map(|number| blob(number, 200)).collect();
    vault.put(&[]).expect("nothing to do");
    vault.put(&borrowed(&blobs)).expect("put");
    vault.put(&borrowed(&blobs[..3])).expect("idempotent");
    assert_eq!(vault.usage(), Ok(Usage { entries: 40, bytes: 8_000 }));
    assert_eq!(vault.get(blobs[7].0), Ok(Some(blobs[7].1.clone())));
    assert_eq!(vault.get(Digest([9; 32])), Ok(None));
    assert_eq!((vault.contains(blobs[1].0), vault.contains(Digest([9; 32]))), (Ok(true), Ok(false)));

    assert_eq!(vault.replace(blobs[1].0, b"flipped"), Ok(true));
    assert_eq!(vault.get(blobs[1].0), Ok(Some(b"flipped".to_vec())));
    assert_eq!(vault.usage().expect("usage").bytes, 7_807);
    vault.put(&borrowed(&blobs[1..2])).expect("put back");
    assert_eq!(vault.get(blobs[1].0), Ok(Some(blobs[1].1.clone())));
    assert_eq!(vault.replace(Digest([9; 32]), b"x"), Ok(false));
    assert_eq!(vault.get(Digest([9; 32])), Ok(None));

    assert_eq!((vault.delete(blobs[0].0), vault.delete(blobs[0].0)), (Ok(true), Ok(false)));
    let mut seen = BTreeMap::new();
    vault.dump(&mut |digest, bytes| drop(seen.insert(digest, bytes.to_vec()))).expect("dumped");
    assert_eq!(seen, blobs[1..].iter().cloned().collect());
    assert_eq!(vault.usage(), Ok(Usage { entries: 39, bytes: 7_800 }));
    assert_eq!(vault.runs(), vault.runs());
    assert!(blobs.iter().all(|(digest, _)| vault.answers(*digest)));
}

#[test]
fn the_embedded_vault_behaves_and_is_durable() {
    let home = tempfile::tempdir().expect("temporary directory");
    let vault = open_vault(None, home.path()).expect("opens");
    behaves(vault.as_ref());
    assert!(vault.durable() && vault.policy_warnings().is_empty());
    drop(vault);
    let vault = open_vault(None, home.path()).expect("opens again");
    assert_eq!(vault.usage(), Ok(Usage { entries: 39, bytes: 7_800 }));
}

#[test]
fn speed_of_the_embedded_vault() {
    let home = tempfile::tempdir().expect("temporary directory");
    let vault = open_vault(None, home.path()).expect("opens");
    for (batch, length) in [(1, 1_024), (64, 1_024), (8, 58_000)] {
        let start = std::time::Instant::now();
        for round in 0..20 {
            let number = |index| u32::try_from(length * 10_000 + round * batch + index).expect("small");
            let blobs: Vec<_> = (0..batch).map(|index| blob(number(index), length)).collect();
            vault.put(&borrowed(&blobs)).expect("put");
        }
        let rate = f64::from(u32::try_from(20 * batch).expect("small")) / start.elapsed().as_secs_f64();
        println!("embedded vault: {rate:.0} puts/s of {length} bytes in batches of {batch}");
    }
    assert!(vault.usage().expect("usage").entries >= 20 * 72);
}

#[test]
fn bad_urls_and_closed_ports_are_told_apart_and_hide_secrets() {
    for url in ["redis://", "http://u:secret@x", "rediss://u:secret@127.0.0.1:1", "secret", "redis://h/x?pass=secret"] {
        let error = RedisVault::open(url).map(drop).expect_err(url);
        assert_eq!(error.kind(), ErrorKind::Input, "{error}");
        assert!(url == "secret" || !error.to_string().contains("secret"), "{error}");
    }
    let closed = std::net::TcpListener::bind("127.0.0.1:0").and_then(|l| l.local_addr()).expect("port");
    let url = format!("redis://user:secret@{closed}/0");
    let error = RedisVault::open(&url).map(drop).expect_err("nobody there");
    assert_eq!(error.kind(), ErrorKind::Unreachable);
    let text = error.to_string();
    assert!(text.contains(&closed.to_string()) && !text.contains("secret") && !text.contains("user"), "{text}");
    let error = RedisVault::open("redis+unix:///nowhere.sock?pass=secret").map(drop).expect_err("nobody there");
    assert!(error.kind() == ErrorKind::Unreachable && !error.to_string().contains("secret"), "{error}");
}

#[test]
fn a_redis_vault_behaves_over_tcp_and_unix_socket() {
    let Some(server) = Server::start(&[]) else { return };
    let home = tempfile::tempdir().expect("temporary directory");
    let vault = open_vault(Some(&server.url()), home.path()).expect("opens");
    behaves(vault.as_ref());
    assert!(!vault.durable());
    assert!(vault.policy_warnings().iter().any(|text| text.contains("appendonly")), "{:?}", vault.policy_warnings());
    vault.dump(&mut |_, _| {}).expect("dumped");
    let socket = open_vault(Some(&server.socket_url()), home.path()).expect("opens");
    assert_eq!(socket.usage(), Ok(Usage { entries: 39, bytes: 7_800 }));

    let start = std::time::Instant::now();
    let blobs: Vec<_> = (1_000..1_400).map(|number| blob(number, 58_000)).collect();
    vault.put(&borrowed(&blobs)).expect("several pipelines");
    let rate = 400.0 / start.elapsed().as_secs_f64();
    println!("redis vault: {rate:.0} puts/s of 58,000 bytes");
    let large = blob(9_999, 20 << 20);
    vault.put(&borrowed(std::slice::from_ref(&large))).expect("alone");
    assert_eq!(vault.get(large.0), Ok(Some(large.1)));
}

#[test]
fn an_evicting_policy_is_refused_with_the_way_out() {
    let Some(server) = Server::start(&["--maxmemory-policy", "allkeys-lru", "--appendonly", "yes"]) else { return };
    let error = RedisVault::open(&server.url()).map(drop).expect_err("refused");
    assert_eq!(error.kind(), ErrorKind::Refused);
    let text = error.to_string();
    assert!(text.contains("allkeys-lru") && text.contains("CONFIG SET maxmemory-policy noeviction"), "{text}");
    server.command(&["CONFIG", "SET", "maxmemory-policy", "noeviction"]);
    let vault = RedisVault::open(&server.url()).expect("fixed");
    assert_eq!(vault.policy_warnings(), Vec::<String>::new());
}

#[test]
fn a_full_redis_says_so_and_takes_all_after_growing() {
    let Some(server) = Server::start(&["--maxmemory", "4mb"]) else { return };
    let vault = RedisVault::open(&server.url()).expect("opens");
    let blobs: Vec<_> = (0..100).map(|number| blob(number, 100_000)).collect();
    let error = vault.put(&borrowed(&blobs)).expect_err("full");
    assert!(matches!(error, StoreError::VaultFull { .. }) && error.is_passing(), "{error}");
    server.command(&["CONFIG", "SET", "maxmemory", "100mb"]);
    vault.put(&borrowed(&blobs)).expect("grown");
    assert_eq!(vault.usage(), Ok(Usage { entries: 100, bytes: 10_000_000 }));
}

#[test]
fn a_restart_is_noticed_and_the_connection_heals() {
    let Some(mut server) = Server::start(&[]) else { return };
    let vault = RedisVault::open(&server.url()).expect("opens");
    let (digest, bytes) = blob(1, 100);
    vault.put(&[(digest, &bytes)]).expect("put");
    let first = vault.runs().expect("told");
    assert_eq!((first.is_empty(), vault.runs().as_ref()), (false, Ok(&first)));
    server.kill();
    let error = vault.get(digest).expect_err("gone");
    assert_eq!(error.kind(), ErrorKind::Unreachable, "{error}");
    assert!(vault.runs().is_err());
    server.revive();
    assert_eq!(vault.get(digest), Ok(None), "all is lost without an append-only file");
    let second = vault.runs().expect("told");
    assert_ne!(second, first);
    server.kill();
    server.revive();
    vault.put(&[(digest, &bytes)]).expect("a dead connection is replaced within the call");
    assert_ne!(vault.runs().expect("told"), second);
}

#[test]
fn a_flush_and_an_eviction_show_in_what_the_server_holds() {
    let Some(server) = Server::start(&["--maxmemory", "4mb"]) else { return };
    let vault = RedisVault::open(&server.url()).expect("opens");
    let (digest, bytes) = blob(1, 100);
    vault.put(&[(digest, &bytes)]).expect("put");
    let first = vault.runs().expect("told");
    assert_eq!(vault.usage(), Ok(Usage { entries: 1, bytes: 100 }), "the mark is no record");
    server.command(&["FLUSHALL"]);
    let second = vault.runs().expect("told");
    assert_ne!(first, second);
    let other = RedisVault::open(&server.url()).expect("opens");
    assert_eq!((other.runs(), vault.runs()), (Ok(second.clone()), Ok(second.clone())), "all who use it see one mark");
    assert_eq!(vault.contains_many(&[digest, digest]), Ok(vec![false, false]));

    server.command(&["CONFIG", "SET", "maxmemory-policy", "allkeys-random"]);
    let told = (0..100).find_map(|_| {
        std::thread::sleep(std::time::Duration::from_millis(100));
        vault.runs().err()
    });
    assert!(matches!(told, Some(StoreError::Policy { .. })), "{told:?}");
    assert!(matches!(vault.put(&[(digest, &bytes)]), Err(StoreError::Policy { .. })), "nothing is put into it");
    for number in 0..60u32 {
        server.command(&["SET", &format!("other:{number}"), &"x".repeat(100_000)]);
    }
    server.command(&["CONFIG", "SET", "maxmemory-policy", "noeviction"]);
    server.command(&["CONFIG", "SET", "maxmemory", "100mb"]);
    assert_ne!(vault.runs().expect("used again"), second, "keys were thrown away");
}

#[test]
fn a_server_that_is_silent_is_told_of_until_it_answers() {
    let Some(server) = Server::start(&[]) else { return };
    let vault = RedisVault::open(&server.url()).expect("opens");
    server.signal("STOP");
    let (digest, _) = blob(1, 100);
    assert_eq!(vault.get(digest).map_err(|error| error.kind()), Err(ErrorKind::Unreachable));
    assert!(vault.ailing().is_some());
    assert_eq!(vault.get(digest).map_err(|error| error.kind()), Err(ErrorKind::Unreachable));
    server.signal("CONT");
    let back = (0..100).find_map(|_| {
        std::thread::sleep(std::time::Duration::from_millis(100));
        vault.get(digest).ok()
    });
    assert_eq!((back, vault.ailing()), (Some(None), None));
}

#[test]
fn a_silent_server_lets_many_questions_wait_once_and_not_once_each() {
    let Some(server) = Server::start(&[]) else { return };
    let digests: Vec<Digest> = (0..64).map(|number| blob(number, 1).0).collect();
    let waits = |asked: &dyn Fn(&RedisVault) -> Result<(), StoreError>| {
        let vault = RedisVault::open(&server.url()).expect("opens");
        server.signal("STOP");
        let begun = std::time::Instant::now();
        let answer = asked(&vault).map_err(|error| error.kind());
        let waited = begun.elapsed();
        server.signal("CONT");
        assert_eq!(answer, Err(ErrorKind::Unreachable));
        waited
    };
    let one = waits(&|vault| vault.contains(digests[0]).map(drop));
    let blobs: Vec<_> = (0..64).map(|number| blob(number, 100)).collect();
    for many in [
        waits(&|vault| vault.contains_many(&digests).map(drop)),
        waits(&|vault| vault.get_many(&digests).map(drop)),
        waits(&|vault| vault.fronts(&digests, 8).map(drop)),
        waits(&|vault| vault.put(&borrowed(&blobs))),
    ] {
        assert!(many < one * 16, "one question waits {one:?}, 64 wait {many:?}");
    }
}

#[test]
fn a_command_that_is_refused_among_many_leaves_the_connection_in_step() {
    let Some(server) = Server::start(&[]) else { return };
    let vault = RedisVault::open(&server.url()).expect("opens");
    let blobs: Vec<_> = (0..4).map(|number| blob(number, 100)).collect();
    vault.put(&borrowed(&blobs)).expect("put");
    server.command(&["DEL", &format!("authros:{}", blobs[1].0)]);
    server.command(&["LPUSH", &format!("authros:{}", blobs[1].0), "not a text"]);
    let digests: Vec<Digest> = blobs.iter().map(|(digest, _)| *digest).collect();
    assert_eq!(vault.get_many(&digests).map_err(|error| error.kind()), Err(ErrorKind::Refused));
    assert_eq!(vault.get(blobs[3].0), Ok(Some(blobs[3].1.clone())), "no answer of before is read");
}

#[test]
fn a_hidden_configuration_is_a_warning_and_a_wrong_password_a_refusal() {
    let Some(server) = Server::start(&["--rename-command", "CONFIG", "", "--requirepass", "hush"]) else { return };
    let vault = RedisVault::open(&server.url().replace("://", "://:hush@")).expect("opens");
    assert!(vault.policy_warnings()[0].contains("does not show"), "{:?}", vault.policy_warnings());
    assert!(!vault.name().contains("hush"), "{}", vault.name());
    for url in [server.url(), server.url().replace("://", "://:wrong@")] {
        let error = RedisVault::open(&url).map(drop).expect_err("no password");
        assert_eq!(error.kind(), ErrorKind::Refused, "{error}");
        assert!(!error.to_string().contains("wrong@"), "{error}");
    }
}
