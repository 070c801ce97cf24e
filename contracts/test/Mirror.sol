// SPDX-License-Identifier: Apache-2.0
pragma solidity >=0.7.6 <0.9.0;
pragma abicoder v2;

import {AuthROS} from "../AuthROS.sol";
import {Cheats, Vm} from "./Vm.sol";

/// @dev The contract's whole state, rebuilt only from its events and the blocks they came in. Taking an event
///      also asserts what must be true of it: the sender may cause it, and it follows from the state before.
abstract contract Mirror is Cheats {
    struct Account {
        bytes identity;
        uint64 epoch;
        bytes32 token;
        bool suspended;
        uint64 keys;
        uint64 count;
        bytes32 last;
    }

    struct Grant {
        bool active;
        uint64 epoch;
        uint64 expiry;
        uint64 revokes;
        bytes32 scope;
    }

    struct Pair {
        uint64 first;
        uint64 second;
    }

    struct Loan {
        bool active;
        uint64 until;
        uint64 lentAt;
        uint64 recalledAt;
    }

    struct Anchor {
        uint64 blockNumber;
        uint64 count;
        uint64 time;
        uint64 keys;
    }

    struct Keys {
        bytes32 identity;
        uint64 blockNumber;
        uint64 time;
    }

    struct Proposal {
        address successor;
        uint64 due;
        address recovery;
    }

    struct Recovery {
        address current;
        uint64 from;
        address next;
    }

    address public administrator;
    address public nominee;
    bool public open;
    uint64 public pausedUntil;
    uint64 public delay;
    mapping(address => bool) public admitted;
    mapping(address => address) public successorOf;
    mapping(address => Account) public accountOf;
    mapping(address => mapping(bytes32 => uint64)) public epochOf;
    mapping(address => mapping(bytes32 => uint64)) public uploadedAt;
    mapping(address => mapping(address => Grant)) public grantOf;
    mapping(address => bytes32) public headOf;
    mapping(address => mapping(bytes32 => Loan)) public loanOf;
    /// @dev revokes and keys
    mapping(address => mapping(address => mapping(uint64 => Pair))) internal envelopeOf;
    mapping(address => mapping(bytes32 => Anchor)) internal anchorOf;
    mapping(address => mapping(uint64 => Keys)) internal keysOf;
    mapping(address => Proposal) internal proposalOf;
    mapping(address => Recovery) internal recoveries;

    /// @dev Takes an event of a transaction sent by `sender` in this block.
    function take(address sender, Vm.Log memory log) internal {
        if (!takeOwners(sender, log)) takeAdministrators(sender, log);
    }

    /// @dev Events of accounts: their subject is the sender of the transaction.
    function takeOwners(address sender, Vm.Log memory log) private returns (bool taken) {
        function(address, Vm.Log memory) internal apply_;
        bytes32 kind = log.topics[0];
        if (kind == keccak256("Registered(address,bytes32,bytes)")) apply_ = registered;
        else if (kind == keccak256("KeysRotated(address,uint64,bytes,bytes)")) apply_ = keysRotated;
        else if (kind == keccak256("DataUploaded(address,bytes32,bytes32,uint64,uint64,bytes)")) apply_ = dataUploaded;
        else if (kind == keccak256("Granted(address,address,uint64,uint64,bytes16[],bytes)")) apply_ = granted;
        else if (kind == keccak256("Wrapped(address,address,uint64,bytes)")) apply_ = wrapped;
        else if (kind == keccak256("Revoked(address,address,uint64,bytes32)")) apply_ = revoked;
        else if (kind == keccak256("Rotated(address,uint64,bytes32)")) apply_ = rotated;
        else if (kind == keccak256("Anchored(address,bytes32,uint64,bytes32)")) apply_ = anchored;
        else if (kind == keccak256("Extended(address,address,uint64)")) apply_ = extended;
        else if (kind == keccak256("RecoveryNamed(address,address,uint64)")) apply_ = recoveryNamed;
        else if (kind == keccak256("Lent(address,bytes32,uint64)")) apply_ = lent;
        else if (kind == keccak256("Recalled(address,bytes32)")) apply_ = recalled;
        else return false;
        vm.assertEq(subject(log), sender, "nobody acts for another");
        apply_(sender, log);
        return true;
    }

    function registered(address owner, Vm.Log memory log) private {
        vm.assertEq(accountOf[owner].epoch, 0, "registered once");
        accountOf[owner].identity = abi.decode(log.data, (bytes));
        accountOf[owner].keys = 1;
        keep(owner, 1);
        beginEpoch(owner, 1, log.topics[2]);
    }

    function keysRotated(address owner, Vm.Log memory log) private {
        (uint64 keys, bytes memory identity,) = abi.decode(log.data, (uint64, bytes, bytes));
        vm.assertEq(keys, accountOf[owner].keys + 1, "keys are numbered");
        accountOf[owner].keys = keys;
        accountOf[owner].identity = identity;
        keep(owner, keys);
    }

    function keep(address owner, uint64 keys) private {
        keysOf[owner][keys] = Keys(keccak256(accountOf[owner].identity), uint64(block.number), uint64(block.timestamp));
    }

    function extended(address owner, Vm.Log memory log) private {
        uint64 expiry = abi.decode(log.data, (uint64));
        Grant storage grant = grantOf[owner][grantee(log)];
        vm.assertTrue(standing(owner, grantee(log)), "only what stands is extended");
        vm.assertTrue(grant.expiry != 0 && (expiry == 0 || expiry > grant.expiry), "never shortened");
        grant.expiry = expiry;
    }

    function recoveryNamed(address owner, Vm.Log memory log) private {
        uint64 from = abi.decode(log.data, (uint64));
        vm.assertEq(from, block.timestamp + delay, "takes effect after the delay");
        recoveries[owner] = Recovery(recoveryOf(owner), from, grantee(log));
    }

    function dataUploaded(address owner, Vm.Log memory log) private {
        (uint64 epoch, uint64 number,) = abi.decode(log.data, (uint64, uint64, bytes));
        bytes32 digest = log.topics[2];
        vm.assertEq(uploadedAt[owner][digest], 0, "a digest is unique per owner");
        vm.assertEq(epoch, epochOf[owner][log.topics[3]], "the epoch is the token's");
        vm.assertEq(number, accountOf[owner].count + 1, "digests are numbered");
        uploadedAt[owner][digest] = uint64(block.number);
        accountOf[owner].count = number;
        accountOf[owner].last = digest;
    }

    function granted(address owner, Vm.Log memory log) private {
        (uint64 epoch, uint64 expiry, bytes16[] memory scope,) =
            abi.decode(log.data, (uint64, uint64, bytes16[], bytes));
        Grant storage grant = grantOf[owner][grantee(log)];
        grant.active = true;
        grant.epoch = epoch;
        grant.expiry = expiry;
        grant.scope = scope.length == 0 ? bytes32(0) : keccak256(abi.encodePacked(scope));
        give(owner, grantee(log), epoch);
    }

    function wrapped(address owner, Vm.Log memory log) private {
        (uint64 epoch,) = abi.decode(log.data, (uint64, bytes));
        if (grantee(log) == owner) {
            vm.assertEq(epoch, accountOf[owner].epoch, "an owner keeps the epoch that it began");
            return;
        }
        vm.assertTrue(standing(owner, grantee(log)), "only grantees get envelopes");
        give(owner, grantee(log), epoch);
    }

    function revoked(address owner, Vm.Log memory log) private {
        (uint64 epoch, bytes32 token) = abi.decode(log.data, (uint64, bytes32));
        Grant storage grant = grantOf[owner][grantee(log)];
        vm.assertTrue(grant.active, "only a grant is revoked");
        grant.active = false;
        grant.revokes += 1;
        beginEpoch(owner, epoch, token);
    }

    function rotated(address owner, Vm.Log memory log) private {
        (uint64 epoch, bytes32 token) = abi.decode(log.data, (uint64, bytes32));
        beginEpoch(owner, epoch, token);
    }

    function anchored(address owner, Vm.Log memory log) private {
        (uint64 count, bytes32 previous) = abi.decode(log.data, (uint64, bytes32));
        bytes32 root = log.topics[2];
        vm.assertEq(previous, headOf[owner], "anchors are chained");
        headOf[owner] = root;
        if (anchorOf[owner][root].blockNumber == 0) {
            anchorOf[owner][root] = Anchor(uint64(block.number), count, uint64(block.timestamp), accountOf[owner].keys);
        }
    }

    function lent(address owner, Vm.Log memory log) private {
        loanOf[owner][log.topics[2]] = Loan(true, abi.decode(log.data, (uint64)), uint64(block.number), 0);
    }

    function recalled(address owner, Vm.Log memory log) private {
        vm.assertTrue(loanOf[owner][log.topics[2]].active, "only what is lent is recalled");
        loanOf[owner][log.topics[2]].active = false;
        loanOf[owner][log.topics[2]].recalledAt = uint64(block.number);
    }

    /// @dev Events of the administrator, and of the nominee who takes over.
    function takeAdministrators(address sender, Vm.Log memory log) private {
        bytes32 kind = log.topics[0];
        if (kind == keccak256("AdministratorChanged(address,address)")) {
            vm.assertEq(subject(log), administrator, "from the administrator");
            vm.assertTrue(administrator == address(0) || sender == nominee, "to the nominee");
            vm.assertEq(address(uint160(uint256(log.topics[2]))), sender, "who accepts");
            administrator = sender;
            nominee = address(0);
            return;
        }
        if (takeSuccessions(sender, log)) return;
        vm.assertEq(sender, administrator, "only the administrator administers");
        if (kind == keccak256("Admitted(address)")) {
            admitted[subject(log)] = true;
        } else if (kind == keccak256("OpenChanged(bool)")) {
            open = abi.decode(log.data, (bool));
        } else if (kind == keccak256("Dismissed(address)")) {
            admitted[subject(log)] = false;
        } else if (kind == keccak256("DelayFixed(uint64)")) {
            vm.assertEq(delay, 0, "fixed once");
            delay = abi.decode(log.data, (uint64));
        } else if (kind == keccak256("PausedUntil(uint64)")) {
            takePause(abi.decode(log.data, (uint64)));
        } else if (kind == keccak256("Suspended(address)")) {
            accountOf[subject(log)].suspended = true;
        } else if (kind == keccak256("Restored(address)")) {
            vm.assertEq(successorOf[subject(log)], address(0), "a lost account stays suspended");
            accountOf[subject(log)].suspended = false;
        } else {
            vm.assertEq(kind, keccak256("AdministratorNominated(address)"), "a known event");
            nominee = subject(log);
        }
    }

    function takePause(uint64 until) private {
        if (paused()) {
            vm.assertEq(until, block.timestamp, "a pause is only ever ended");
        } else {
            vm.assertLe(until, block.timestamp + 3 days, "a pause is short");
            vm.assertTrue(pausedUntil == 0 || block.timestamp >= pausedUntil + 7 days, "and seldom");
        }
        pausedUntil = until;
    }

    /// @dev A succession is proposed by the administrator, stopped by her or the recovery account of that time, and
    ///      completed by anybody, but not before its time.
    function takeSuccessions(address sender, Vm.Log memory log) private returns (bool taken) {
        bytes32 kind = log.topics[0];
        if (log.topics.length < 2) return false;
        address lost = subject(log);
        Proposal memory proposal = proposalOf[lost];
        if (kind == keccak256("SuccessionProposed(address,address,address,uint64)")) {
            vm.assertEq(sender, administrator, "only the administrator proposes");
            vm.assertEq(proposal.due, 0, "one at a time");
            (address recovery, uint64 due) = abi.decode(log.data, (address, uint64));
            vm.assertEq(recovery, recoveryOf(lost), "who may stop it");
            vm.assertEq(due, block.timestamp + (recovery == address(0) ? 2 * delay : delay), "it waits");
            proposalOf[lost] = Proposal(grantee(log), due, recovery);
        } else if (kind == keccak256("SuccessionCancelled(address,address)")) {
            vm.assertTrue(proposal.due != 0, "what is stopped was proposed");
            vm.assertEq(grantee(log), sender, "who stopped it");
            vm.assertTrue(sender == administrator || sender == proposal.recovery, "and may");
            delete proposalOf[lost];
        } else if (kind == keccak256("Succeeded(address,address)")) {
            vm.assertTrue(proposal.due != 0 && block.timestamp >= proposal.due, "nothing before its time");
            vm.assertEq(grantee(log), proposal.successor, "as proposed");
            delete proposalOf[lost];
            successorOf[lost] = grantee(log);
            accountOf[lost].suspended = true;
        } else {
            return false;
        }
        return true;
    }

    function beginEpoch(address owner, uint64 epoch, bytes32 token) private {
        vm.assertEq(epoch, accountOf[owner].epoch + 1, "the epoch only grows, by one");
        vm.assertEq(epochOf[owner][token], 0, "a token is used once");
        accountOf[owner].epoch = epoch;
        accountOf[owner].token = token;
        epochOf[owner][token] = epoch;
    }

    function give(address owner, address to, uint64 epoch) private {
        envelopeOf[owner][to][epoch] = Pair(grantOf[owner][to].revokes, accountOf[to].keys);
    }

    function paused() public view returns (bool) {
        return block.timestamp < pausedUntil;
    }

    /// @dev Who may stop a succession that is proposed now.
    function recoveryOf(address owner) public view returns (address) {
        Recovery memory named = recoveries[owner];
        return named.from != 0 && named.from <= block.timestamp ? named.next : named.current;
    }

    /// @dev Whether a grant is neither revoked nor expired.
    function standing(address owner, address reader) public view returns (bool) {
        Grant memory grant = grantOf[owner][reader];
        return grant.active && (grant.expiry == 0 || grant.expiry > block.timestamp);
    }

    function subject(Vm.Log memory log) private pure returns (address) {
        return address(uint160(uint256(log.topics[1])));
    }

    function grantee(Vm.Log memory log) private pure returns (address) {
        return address(uint160(uint256(log.topics[2])));
    }
}
