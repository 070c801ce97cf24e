use super::{MOST_REMEMBERED, place_of, *};

const HERE: IpAddr = IpAddr::V4(std::net::Ipv4Addr::LOCALHOST);

fn small() -> Limits {
    Limits {
        connections: 4,
        connections_of_peer: 2,
        handshakes: 16,
        handshake_burst: 5.0,
        handshake_rate: 1.0,
        frame_rate: 10.0,
        byte_rate: 1000.0,
        relay_burst: 10.0,
        relay_rate: 5.0,
        quota_of_peer: 100,
        quota: 150,
        ..Limits::default()
    }
}

fn other(last: u8) -> IpAddr {
    IpAddr::from([10, 0, 0, last])
}

fn six(network: u16, peer: u16) -> IpAddr {
    IpAddr::from([0x2001, 0xdb8, network, peer, 0, 0, 0, 1])
}

fn is_busy(outcome: Result<Seat>) -> bool {
    outcome.is_err_and(|refusal| refusal.code == Code::Busy)
}

fn is_evicted(seat: &mut Seat) -> bool {
    let mut context = std::task::Context::from_waker(std::task::Waker::noop());
    std::pin::pin!(seat.evicted()).poll(&mut context).is_ready()
}

#[test]
fn connections_and_handshakes_are_bounded_and_given_back() {
    let (peers, now) = (Peers::new(small()), Instant::now());
    let seats = [peers.admit(HERE, now).expect("one"), peers.admit(HERE, now).expect("two")];
    assert!(is_busy(peers.admit(HERE, now)), "a third of one peer");
    let more = [peers.admit(other(1), now).expect("another peer"), peers.admit(other(2), now).expect("a third")];
    assert!(is_busy(peers.admit(other(3), now)), "four in all");
    assert_eq!(peers.connections(), 4);
    drop((seats, more));
    assert_eq!(peers.connections(), 0);
    for _ in 0..3 {
        peers.admit(HERE, now).expect("burst not used up");
    }
    assert!(is_busy(peers.admit(HERE, now)), "burst used up");
    peers.admit(HERE, now + Duration::from_secs(1)).expect("filled again");
}

#[test]
fn one_peer_holds_an_eighth_of_the_handshakes_and_the_oldest_makes_room() {
    let limits = Limits { handshakes: 16, handshake_burst: 100.0, ..Limits::default() };
    let (peers, now) = (Peers::new(limits), Instant::now());
    let mut seats = Vec::new();
    for peer in 0..8 {
        seats.push(peers.admit(other(peer), now).expect("one"));
        seats.push(peers.admit(other(peer), now).expect("two"));
        assert!(is_busy(peers.admit(other(peer), now)), "an eighth is two");
    }
    assert!(!is_evicted(&mut seats[0]));
    let mut late = peers.admit(other(9), now).expect("a seventeenth");
    assert!(is_evicted(&mut seats[0]) && !is_evicted(&mut seats[1]), "the oldest goes");
    // An authenticated connection holds no place and is left alone.
    seats[1].authenticated();
    let mut later: Vec<Seat> = (10..14).map(|peer| peers.admit(other(peer), now).expect("room")).collect();
    assert!(!is_evicted(&mut seats[1]) && is_evicted(&mut seats[2]) && !is_evicted(&mut late));
    assert!(!later.iter_mut().any(is_evicted));
    drop(seats);
    peers.admit(other(0), now).expect("its places came back");
}

#[test]
fn a_network_of_ipv6_has_a_share_and_its_peers_have_theirs() {
    let limits = Limits { handshakes: 16, handshake_burst: 10.0, handshake_rate: 0.001, ..Limits::default() };
    let (peers, now) = (Peers::new(limits), Instant::now());
    let seats: Vec<Seat> = (0..4).map(|peer| peers.admit(six(1, peer), now).expect("a quarter")).collect();
    assert!(is_busy(peers.admit(six(1, 5), now)), "a fifth of one network");
    peers.admit(six(2, 1), now).expect("another network");
    drop(seats);
    let arrived = (0..1000).filter(|peer| peers.admit(six(1, *peer), now).is_ok()).count();
    assert_eq!(arrived, 4 * 10 - 4, "four peers' worth of handshakes, of which four were used");
}

/// A visitor's place for a peer that has just arrived.
fn visit(peers: &Peers, address: IpAddr, now: Instant) -> Result<Seat> {
    let mut seat = peers.admit(address, now).expect("admitted");
    seat.visit().map(|()| seat)
}

#[test]
fn a_newcomer_takes_the_place_of_the_oldest_visitor_of_those_who_hold_the_most() {
    let limits = Limits { visits: 8, visits_of_peer: 2, ..Limits::default() };
    let (peers, now) = (Peers::new(limits), Instant::now());
    let visit = |address: IpAddr| visit(&peers, address, now);
    let mut held: Vec<Seat> = (0..8).map(|index| visit(other(1 + index / 2)).expect("two each of four")).collect();
    assert_eq!(visit(other(1)).expect_err("a third of one peer").code, Code::Busy);
    assert!(!held.iter_mut().any(is_evicted), "who has his share drops nobody");
    let mut newcomer = visit(other(9)).expect("a newcomer takes a place");
    assert!(is_evicted(&mut held[0]) && !is_evicted(&mut held[1]), "the oldest goes");
    // The one that was dropped comes back at once: it drops others who hold two, never the newcomer.
    let mut again: Vec<Seat> = (0..3).map(|_| visit(other(1))).filter_map(Result::ok).collect();
    assert_eq!(again.len(), 1, "one more is its share");
    assert!(is_evicted(&mut held[1]) || is_evicted(&mut held[2]));
    for round in 10..40 {
        again.push(visit(other(round)).expect("another newcomer"));
        let dropped = is_evicted(&mut newcomer);
        assert!(round > 12 || !dropped, "dropped while others hold two each: {round}");
    }
    drop((held, again, newcomer));
    let all: Vec<Seat> = (0..8).map(|index| visit(other(1 + index / 2)).expect("all places came back")).collect();
    assert_eq!(all.len(), 8);
}

#[test]
fn newcomers_from_many_addresses_are_bounded_together() {
    let limits = Limits { newcomer_burst: 4.0, newcomer_rate: 0.2, ..Limits::default() };
    let (peers, now) = (Peers::new(limits), Instant::now());
    let seats: Vec<Seat> = (0..40).map(|last| peers.admit(other(last), now).expect("admitted")).collect();
    assert_eq!((0..9).filter(|_| seats[0].newcomer(now).is_ok()).count(), 4, "of one peer");
    let all = seats.iter().skip(1).flat_map(|seat| [seat; 4]).filter(|seat| seat.newcomer(now).is_ok()).count();
    assert_eq!(all, 12, "16 of all peers together, of which 4 were used");
    assert!(seats[1].newcomer(now + Duration::from_secs(5)).is_ok(), "one in five seconds");
    assert!(seats[2].newcomer(now + Duration::from_secs(5)).is_err());
}

#[test]
fn the_peers_of_an_ipv6_network_hold_visitors_places_together() {
    let limits = Limits { visits: 8, visits_of_peer: 2, ..Limits::default() };
    let (peers, now) = (Peers::new(limits), Instant::now());
    let visit = |address: IpAddr| visit(&peers, address, now);
    let mut held: Vec<Seat> = (0..4).map(|peer| visit(six(1, peer)).expect("one each of four")).collect();
    assert_eq!(visit(six(1, 5)).expect_err("a fifth of the network").code, Code::Busy);
    let mut single = visit(six(2, 0)).expect("another network");
    let others: Vec<Seat> = (0..4).map(|last| visit(other(last)).expect("more")).collect();
    assert!(is_evicted(&mut held[0]) && !is_evicted(&mut single), "the network that holds four makes room");
    drop(others);
}

#[test]
fn frames_bytes_and_requests_to_the_chain_over_the_rate_wait() {
    let (peers, now) = (Peers::new(small()), Instant::now());
    let seat = peers.admit(HERE, now).expect("admitted");
    assert_eq!(seat.pace(now, 1000), Duration::ZERO);
    assert_eq!(seat.pace(now, 500), Duration::from_millis(500));
    assert_eq!(seat.pace(now + Duration::from_secs(2), 0), Duration::ZERO);
    let later = now + Duration::from_secs(60);
    let waits: Vec<Duration> = (0..12).map(|_| seat.pace(later, 0)).collect();
    assert!(waits[9].is_zero() && !waits[10].is_zero(), "{waits:?}");
    assert_eq!(seat.pace_relay(now, 10), Duration::ZERO);
    let other = peers.admit(HERE, now).expect("admitted");
    assert_eq!(other.pace_relay(now, 5), Duration::from_secs(1), "of one peer together");
}

#[test]
fn memory_is_charged_by_peer_and_in_all() {
    let (peers, now) = (Peers::new(small()), Instant::now());
    let (one, two) = (peers.admit(HERE, now).expect("one"), peers.admit(other(1), now).expect("two"));
    let charge = one.charge(100).expect("fits");
    assert_eq!(one.charge(1).expect_err("peer's quota").code, Code::Quota);
    assert_eq!(two.charge(51).expect_err("all quota").code, Code::Quota);
    drop(charge);
    two.charge(100).expect("given back");
    assert!(one.charge(usize::MAX).is_err());
}

#[test]
fn an_address_belongs_to_a_peer_and_a_flood_of_peers_pays_no_debts() {
    let address = |text: &str| place_of(text.parse::<IpAddr>().expect("address"));
    assert_eq!(address("2001:db8::1"), address("2001:db8::2:3"));
    assert_ne!(address("2001:db8::1").peer, address("2001:db8:0:1::1").peer);
    assert_eq!(address("2001:db8::1").network, address("2001:db8:0:1::1").network);
    assert_ne!(address("2001:db8::1").network, address("2001:db8:1::1").network);
    assert_eq!(address("::ffff:10.0.0.1"), place_of(other(1)));
    let (peers, now) = (Peers::new(Limits { connections: 100_000, ..small() }), Instant::now());
    let debtor = other(200);
    for _ in 0..5 {
        drop(peers.admit(debtor, now).expect("burst"));
    }
    let admitted = (0..40_000u32).filter(|number| peers.admit(IpAddr::from(number.to_be_bytes()), now).is_ok()).count();
    assert!(peers.lock().peers.len() <= MOST_REMEMBERED + 1);
    assert!(admitted < MOST_REMEMBERED + 10, "who is not remembered shares one burst: {admitted}");
    assert!(is_busy(peers.admit(debtor, now)), "a debt is not forgotten in a flood");
    let calm = now + Duration::from_secs(60);
    peers.admit(debtor, calm).expect("paid by time");
    for number in 0..1_000u32 {
        drop(peers.admit(IpAddr::from((0x4000_0000 + number).to_be_bytes()), calm).expect("idle peers are forgotten"));
    }
}
