// SPDX-License-Identifier: Apache-2.0
pragma solidity >=0.7.6 <0.9.0;
pragma abicoder v2;

import {AuthROS} from "../AuthROS.sol";
import {Compared} from "./Compared.sol";
import {Vm} from "./Vm.sol";

/// @dev Six people, including the administrator, who do everything that the contract offers, in any order, rightly and
///      wrongly. For each act it is predicted whether it must succeed; its events go into the mirror.
contract Crowd is Compared {
    /// @dev How often an act (by its selector) was done, and refused.
    mapping(bytes4 => uint256) public doneOf;
    mapping(bytes4 => uint256) public refusedOf;
    mapping(address => uint64) private seenEpoch;

    constructor() {
        for (uint160 index = 1; index <= 6; index++) {
            people.push(address(0xc0000 + index));
        }
        vm.warp(1000);
        vm.recordLogs();
        vm.prank(people[0]);
        authros = new AuthROS(true, 1 days);
        takeAll(people[0]);
    }

    function person(uint256 seed) public view returns (address) {
        return people[seed % people.length];
    }

    function population() external view returns (uint256) {
        return people.length;
    }

    // ---- accounts ----

    function register(uint256 who, uint256 token) external {
        address sender = person(who);
        bool due = !paused() && !accountOf[sender].suspended && accountOf[sender].epoch == 0
            && (open || admitted[sender]) && word(token) != 0;
        act(sender, abi.encodeWithSelector(authros.register.selector, identity(word(token), who), envelope(who)), due);
    }

    function rotateKeys(uint256 who, uint256 token) external {
        address sender = person(who);
        bytes32 chosen = token % 2 == 0 ? accountOf[sender].token : word(token);
        bool due = acting(sender) && chosen == accountOf[sender].token;
        act(sender, abi.encodeWithSelector(authros.rotateKeys.selector, identity(chosen, token), envelope(token)), due);
    }

    function rotate(uint256 who, uint256 token) external {
        address sender = person(who);
        bool due = accountOf[sender].epoch != 0 && fresh(sender, word(token));
        act(sender, abi.encodeWithSelector(authros.rotate.selector, word(token), envelope(who)), due);
    }

    function dataUpload(uint256 who, uint256 digest, uint256 token, uint256 length) external {
        address sender = person(who);
        bytes32 chosen = token % 2 == 0 ? accountOf[sender].token : word(token);
        bool due = acting(sender) && epochOf[sender][chosen] != 0 && uploadedAt[sender][word(digest)] == 0
            && length % 34 <= 32;
        bytes memory timestamp = new bytes(length % 34);
        act(
            sender,
            abi.encodeWithSelector(
                authros.dataUpload.selector, abi.encode(word(digest)), abi.encode(chosen), timestamp
            ),
            due
        );
    }

    function anchor(uint256 who, uint256 root, uint256 count, uint256 previous) external {
        address sender = person(who);
        bytes32 chosen = previous % 2 == 0 ? headOf[sender] : word(previous);
        uint64 leaves = uint64(count % 5);
        bool due = acting(sender) && word(root) != 0 && leaves != 0 && chosen == headOf[sender];
        act(sender, abi.encodeWithSelector(authros.anchor.selector, word(root), leaves, chosen), due);
    }

    function lend(uint256 who, uint256 device, uint256 end) external {
        address sender = person(who);
        bool due = acting(sender) && word(device) != 0 && (time(end) == 0 || time(end) > block.timestamp);
        act(sender, abi.encodeWithSelector(authros.lend.selector, word(device), time(end)), due);
    }

    function recall(uint256 who, uint256 device) external {
        address sender = person(who);
        bool due = accountOf[sender].epoch != 0 && loanOf[sender][word(device)].active;
        act(sender, abi.encodeWithSelector(authros.recall.selector, word(device)), due);
    }

    function nameRecovery(uint256 who, uint256 recovery) external {
        address sender = person(who);
        address chosen = recovery % 7 == 0 ? address(0) : person(recovery);
        bool due = acting(sender) && chosen != sender;
        act(sender, abi.encodeWithSelector(authros.nameRecovery.selector, chosen), due);
    }

    // ---- grants ----

    function authorityGrant(uint256 who, uint256 reader, uint256 epoch, uint256 end, uint256 topics) external {
        address sender = person(who);
        uint64 chosen = epochFor(sender, epoch);
        bool due = acting(sender) && sender != person(reader) && (time(end) == 0 || time(end) > block.timestamp)
            && topics % 34 <= 32 && wrappable(sender, person(reader), chosen);
        bytes16[] memory scope = new bytes16[](topics % 2 == 0 ? 0 : topics % 34);
        if (topics % 34 == 33) scope = new bytes16[](33);
        act(
            sender,
            abi.encodeWithSelector(
                authros.authorityGrant.selector, person(reader), chosen, time(end), scope, bytes("envelope")
            ),
            due
        );
    }

    function extend(uint256 who, uint256 reader, uint256 end) external {
        address sender = person(who);
        address chosen = reading(sender, reader);
        uint64 expiry = grantOf[sender][chosen].expiry;
        uint64 later = end % 2 == 0 ? time(end / 2) : expiry + uint64(end % 50);
        bool due = acting(sender) && standing(sender, chosen) && expiry != 0 && (later == 0 || later > expiry);
        act(sender, abi.encodeWithSelector(authros.extend.selector, chosen, later), due);
    }

    function wrap(uint256 who, uint256 reader, uint256 second, uint256 epoch) external {
        address sender = person(who);
        uint64 chosen = epochFor(sender, epoch);
        bool due = acting(sender);
        address[] memory grantees = new address[](second % 3 == 0 ? 2 : 1);
        for (uint256 index = 0; index < grantees.length; index++) {
            grantees[index] = person(index == 0 ? reader : second);
            due = due && standing(sender, grantees[index]) && wrappable(sender, grantees[index], chosen);
        }
        if (grantees.length == 2 && grantees[0] == grantees[1]) due = false;
        bytes[] memory envelopes = new bytes[](grantees.length);
        for (uint256 index = 0; index < grantees.length; index++) {
            envelopes[index] = "envelope";
        }
        act(sender, abi.encodeWithSelector(authros.wrap.selector, grantees, chosen, envelopes), due);
    }

    function authorityRevoke(uint256 who, uint256 reader, uint256 token) external {
        address sender = person(who);
        bool due = accountOf[sender].epoch != 0 && grantOf[sender][person(reader)].active && fresh(sender, word(token));
        act(
            sender,
            abi.encodeWithSelector(authros.authorityRevoke.selector, person(reader), word(token), envelope(who)),
            due
        );
    }

    // ---- administrator ----

    function admit(uint256 who, uint256 account) external {
        bool due = chief(who) == administrator && !admitted[person(account)];
        act(chief(who), abi.encodeWithSelector(authros.admit.selector, person(account)), due);
    }

    function setOpen(uint256 who, uint256 seed) external {
        bool due = chief(who) == administrator && open != (seed % 2 == 0);
        act(chief(who), abi.encodeWithSelector(authros.setOpen.selector, seed % 2 == 0), due);
    }

    function dismiss(uint256 who, uint256 account) external {
        bool due = chief(who) == administrator && admitted[person(account)];
        act(chief(who), abi.encodeWithSelector(authros.dismiss.selector, person(account)), due);
    }

    /// @dev For up to five minutes, now and then for four days, or until a time that has passed.
    function pause(uint256 who, uint256 seed) external {
        uint64 until = uint64(block.timestamp + (seed % 16 == 0 ? 4 days : seed % 400)) - 100;
        bool due = chief(who) == administrator && until > block.timestamp && until <= block.timestamp + 3 days
            && (pausedUntil == 0 || block.timestamp >= pausedUntil + 7 days);
        act(chief(who), abi.encodeWithSelector(authros.pause.selector, until), due);
    }

    function resume(uint256 who) external {
        bool due = chief(who) == administrator && paused();
        act(chief(who), abi.encodeWithSelector(authros.resume.selector), due);
    }

    function suspend(uint256 who, uint256 account) external {
        bool due = chief(who) == administrator && !accountOf[person(account)].suspended;
        act(chief(who), abi.encodeWithSelector(authros.suspend.selector, person(account)), due);
    }

    function restore(uint256 who, uint256 account) external {
        address chosen = person(account);
        bool due = chief(who) == administrator && accountOf[chosen].suspended && successorOf[chosen] == address(0);
        act(chief(who), abi.encodeWithSelector(authros.restore.selector, chosen), due);
    }

    /// @dev Rarely: a lost account is out of the game.
    function proposeSuccession(uint256 who, uint256 lost, uint256 successor, uint256 seldom) external {
        if (seldom % 3 != 0) return;
        (address from, address to) = (person(lost), person(successor));
        bool due = chief(who) == administrator && from != to && accountOf[from].epoch != 0 && accountOf[to].epoch != 0
            && !accountOf[to].suspended && successorOf[from] == address(0) && proposalOf[from].due == 0;
        act(chief(who), abi.encodeWithSelector(authros.proposeSuccession.selector, from, to), due);
    }

    function cancelSuccession(uint256 who, uint256 lost) external {
        address chosen = proposed(lost);
        address recovery = proposalOf[chosen].recovery;
        address sender = who % 4 == 0 && recovery != address(0) ? recovery : person(who / 4);
        bool due = proposalOf[chosen].due != 0 && (sender == recovery || sender == administrator);
        act(sender, abi.encodeWithSelector(authros.cancelSuccession.selector, chosen), due);
    }

    function completeSuccession(uint256 who, uint256 lost) external {
        address chosen = proposed(lost);
        Proposal memory proposal = proposalOf[chosen];
        bool due = proposal.due != 0 && block.timestamp >= proposal.due && !accountOf[proposal.successor].suspended;
        act(person(who), abi.encodeWithSelector(authros.completeSuccession.selector, chosen), due);
    }

    function nominate(uint256 who, uint256 account) external {
        bool due = chief(who) == administrator;
        act(chief(who), abi.encodeWithSelector(authros.nominate.selector, person(account)), due);
    }

    function acceptAdministrator(uint256 who) external {
        address sender = who % 2 == 0 && nominee != address(0) ? nominee : person(who);
        act(sender, abi.encodeWithSelector(authros.acceptAdministrator.selector), sender == nominee);
    }

    /// @dev Some seconds; now and then a day.
    function passTime(uint256 seconds_) external {
        vm.warp(block.timestamp + (seconds_ % 8 == 0 ? 1 days : seconds_ % 30));
        vm.roll(block.number + 1 + (seconds_ % 3));
    }

    // ---- reading ----

    /// @dev Asks for everybody's records in everybody's name, under each token in use and one that is not.
    function readAll() external {
        for (uint256 index = 0; index < people.length; index++) {
            for (uint256 token = 0; token < WORDS; token++) {
                uint64 epoch = epochOf[people[index]][bytes32(token)];
                if (token != 0 && epoch == 0) continue;
                for (uint256 other = 0; other < people.length; other++) {
                    read(people[index], people[other], token, epoch);
                }
            }
        }
    }

    function read(address owner, address reader, uint256 token, uint64 epoch) private {
        vm.prank(reader);
        (bool authorised, uint64 found, uint64 count, bytes32 last) = authros.dataQuery(abi.encode(token), owner);
        vm.assertTrue(authorised == mayRead(owner, reader, epoch), "who may read");
        if (owner != reader && !standing(owner, reader)) vm.assertTrue(!authorised, "a revoked or expired grantee");
        vm.assertTrue(found == epoch, "epoch");
        vm.assertTrue(count == (authorised ? accountOf[owner].count : 0), "count");
        vm.assertTrue(last == (authorised ? accountOf[owner].last : bytes32(0)), "last");
    }

    // ---- inner ----

    function act(address sender, bytes memory data, bool due) private {
        vm.recordLogs();
        vm.prank(sender);
        (bool done, bytes memory answer) = address(authros).call(data);
        vm.assertEq(done, due, "what must succeed succeeds, and nothing else");
        if (done) {
            doneOf[msg.sig] += 1;
            vm.assertTrue(takeAll(sender) > 0, "every change emits an event");
        } else {
            refusedOf[msg.sig] += 1;
            vm.assertTrue(answer.length > 68, "a refusal has its reason");
        }
        for (uint256 index = 0; index < people.length; index++) {
            (, uint64 epoch,,,,,) = authros.accountOf(people[index]);
            vm.assertLe(seenEpoch[people[index]], epoch, "the epoch only grows");
            seenEpoch[people[index]] = epoch;
        }
    }

    function takeAll(address sender) private returns (uint256 count) {
        Vm.Log[] memory logs = vm.getRecordedLogs();
        for (count = 0; count < logs.length; count++) {
            vm.assertEq(logs[count].emitter, address(authros), "emitter");
            take(sender, logs[count]);
        }
    }

    function acting(address who) public view returns (bool) {
        return !paused() && accountOf[who].epoch != 0 && !accountOf[who].suspended;
    }

    /// @dev What an owner wraps for itself: now and then nothing.
    function envelope(uint256 seed) private pure returns (bytes memory) {
        return seed % 3 == 0 ? bytes("") : bytes("own");
    }

    function fresh(address who, bytes32 token) private view returns (bool) {
        return token != 0 && epochOf[who][token] == 0;
    }

    /// @dev Whether an envelope may be given: for a begun epoch, and none since the last revoke for the same keys.
    function wrappable(address owner, address reader, uint64 epoch) private view returns (bool) {
        if (accountOf[reader].epoch == 0 || epoch == 0 || epoch > accountOf[owner].epoch) return false;
        Pair memory given = envelopeOf[owner][reader][epoch];
        return given.second != accountOf[reader].keys || given.first != grantOf[owner][reader].revokes;
    }

    /// @dev Whether a reader may read what an owner sealed in an epoch.
    function mayRead(address owner, address reader, uint64 epoch) private view returns (bool) {
        if (epoch == 0) return false;
        if (owner == reader) return true;
        if (!standing(owner, reader) || accountOf[reader].suspended) return false;
        Pair memory given = envelopeOf[owner][reader][epoch];
        return
            epoch >= grantOf[owner][reader].epoch
                || (given.second != 0 && given.first == grantOf[owner][reader].revokes);
    }

    /// @dev Most of the time somebody with a pending succession, if there is one.
    function proposed(uint256 seed) private view returns (address) {
        for (uint256 index = 0; seed % 8 != 0 && index < people.length; index++) {
            address candidate = person(seed % 8 + index);
            if (proposalOf[candidate].due != 0) return candidate;
        }
        return person(seed);
    }

    /// @dev Most of the time somebody with an owner's grant that has an end, if there is one.
    function reading(address owner, uint256 seed) private view returns (address) {
        for (uint256 index = 0; seed % 8 != 0 && index < people.length; index++) {
            address candidate = person(seed % 8 + index);
            if (standing(owner, candidate) && grantOf[owner][candidate].expiry != 0) return candidate;
        }
        return person(seed);
    }

    /// @dev Half of the time the administrator.
    function chief(uint256 seed) private view returns (address) {
        return seed % 2 == 0 ? administrator : person(seed / 2);
    }

    /// @dev Half of the time the current epoch.
    function epochFor(address owner, uint256 seed) private view returns (uint64) {
        return seed % 2 == 0 ? accountOf[owner].epoch : uint64((seed / 2) % WORDS);
    }

    /// @dev No end, one in the past, or one soon.
    function time(uint256 seed) private view returns (uint64) {
        return seed % 4 == 0 ? 0 : uint64(block.timestamp + (seed % 100)) - 10;
    }

    function word(uint256 seed) private pure returns (bytes32) {
        return bytes32(seed % WORDS);
    }

    function identity(bytes32 token, uint256 fill) private pure returns (bytes memory) {
        return abi.encodePacked(token, fill, fill, fill, fill, fill, fill);
    }
}
