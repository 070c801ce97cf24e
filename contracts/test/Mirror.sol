// SPDX-License-Identifier: Apache-2.0
pragma solidity >=0.7.6 <0.9.0;
pragma abicoder v2;

import {AuthROS} from "../AuthROS.sol";
import {Cheats, Vm} from "./Vm.sol";

/// @dev The contract's whole state, rebuilt from nothing but its events and the blocks they came in. Taking an event
///      also asserts what must be true of it: who sent the transaction may cause it, and it follows from what was before.
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
    }

    address public administrator;
    address public nominee;
    bool public open;
    bool public paused;
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
    /// @dev block and count
    mapping(address => mapping(bytes32 => Pair)) internal anchorOf;

    /// @dev Takes an event of a transaction that `sender` sent in this block.
    function take(address sender, Vm.Log memory log) internal {
        if (!takeOwners(sender, log)) takeAdministrators(sender, log);
    }

    /// @dev Events of accounts: their subject is who sent the transaction.
    function takeOwners(address sender, Vm.Log memory log) private returns (bool taken) {
        function(address, Vm.Log memory) internal apply_;
        bytes32 kind = log.topics[0];
        if (kind == keccak256("Registered(address,bytes32,bytes)")) apply_ = registered;
        else if (kind == keccak256("KeysRotated(address,uint64,bytes)")) apply_ = keysRotated;
        else if (kind == keccak256("DataUploaded(address,bytes32,bytes32,uint64,uint64,bytes)")) apply_ = dataUploaded;
        else if (kind == keccak256("Granted(address,address,uint64,uint64,bytes16[],bytes)")) apply_ = granted;
        else if (kind == keccak256("Wrapped(address,address,uint64,bytes)")) apply_ = wrapped;
        else if (kind == keccak256("Revoked(address,address,uint64,bytes32)")) apply_ = revoked;
        else if (kind == keccak256("Rotated(address,uint64,bytes32)")) apply_ = rotated;
        else if (kind == keccak256("Anchored(address,bytes32,uint64,bytes32)")) apply_ = anchored;
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
        beginEpoch(owner, 1, log.topics[2]);
    }

    function keysRotated(address owner, Vm.Log memory log) private {
        (uint64 keys, bytes memory identity) = abi.decode(log.data, (uint64, bytes));
        vm.assertEq(keys, accountOf[owner].keys + 1, "keys are numbered");
        accountOf[owner].keys = keys;
        accountOf[owner].identity = identity;
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
        if (anchorOf[owner][root].first == 0) anchorOf[owner][root] = Pair(uint64(block.number), count);
    }

    function lent(address owner, Vm.Log memory log) private {
        loanOf[owner][log.topics[2]] = Loan(true, abi.decode(log.data, (uint64)));
    }

    function recalled(address owner, Vm.Log memory log) private {
        vm.assertTrue(loanOf[owner][log.topics[2]].active, "only what is lent is recalled");
        loanOf[owner][log.topics[2]].active = false;
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
        vm.assertEq(sender, administrator, "only the administrator administers");
        if (kind == keccak256("Admitted(address)")) {
            admitted[subject(log)] = true;
        } else if (kind == keccak256("OpenChanged(bool)")) {
            open = abi.decode(log.data, (bool));
        } else if (kind == keccak256("PausedChanged(bool)")) {
            paused = abi.decode(log.data, (bool));
        } else if (kind == keccak256("Suspended(address)")) {
            accountOf[subject(log)].suspended = true;
        } else if (kind == keccak256("Restored(address)")) {
            vm.assertEq(successorOf[subject(log)], address(0), "a lost account stays suspended");
            accountOf[subject(log)].suspended = false;
        } else if (kind == keccak256("Succeeded(address,address)")) {
            successorOf[subject(log)] = grantee(log);
            accountOf[subject(log)].suspended = true;
        } else {
            vm.assertEq(kind, keccak256("AdministratorNominated(address)"), "a known event");
            nominee = subject(log);
        }
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
