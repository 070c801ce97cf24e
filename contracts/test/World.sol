// SPDX-License-Identifier: Apache-2.0
pragma solidity >=0.7.6 <0.9.0;
pragma abicoder v2;

import {AuthROS} from "../AuthROS.sol";
import {Cheats, Vm} from "./Vm.sol";

/// @dev A contract open to registration at time 1,000, with A, B and C registered under tokens 0xa1, 0xb1 and 0xc1.
abstract contract World is Cheats {
    struct Account {
        bytes identity;
        uint64 epoch;
        bytes32 token;
        bool suspended;
        uint64 keys;
        uint64 count;
        bytes32 last;
    }

    address internal constant ADMIN = address(0xad0000);
    address internal constant A = address(0xa0000);
    address internal constant B = address(0xb0000);
    address internal constant C = address(0xc0000);
    address internal constant STRANGER = address(0xff0000);

    /// @dev How long a succession waits.
    uint64 internal constant DELAY = 7 days;

    AuthROS internal authros;

    function setUp() public virtual {
        vm.warp(1000);
        authros = deploy(true);
        register(A, 0xa1);
        register(B, 0xb1);
        register(C, 0xc1);
    }

    function deploy(bool open) internal returns (AuthROS deployed) {
        vm.prank(ADMIN);
        deployed = new AuthROS(open, DELAY);
    }

    function register(address who, uint256 token) internal {
        by(who);
        authros.register(identity(token, 1), "");
    }

    /// @dev 224 bytes: the token, then keys and proof made of `fill`; the contract does not check them.
    function identity(uint256 token, uint8 fill) internal pure returns (bytes memory text) {
        text = abi.encodePacked(token, filled(192, fill));
    }

    function filled(uint256 length, uint8 fill) internal pure returns (bytes memory text) {
        text = new bytes(length);
        for (uint256 index = 0; index < length; index++) {
            text[index] = bytes1(fill);
        }
    }

    function topics(uint256 count) internal pure returns (bytes16[] memory ids) {
        ids = new bytes16[](count);
        for (uint256 index = 0; index < count; index++) {
            ids[index] = bytes16(uint128(index + 1));
        }
    }

    function only(address who) internal pure returns (address[] memory list) {
        list = new address[](1);
        list[0] = who;
    }

    function only(bytes memory envelope) internal pure returns (bytes[] memory list) {
        list = new bytes[](1);
        list[0] = envelope;
    }

    /// @dev The next call comes from `sender`.
    function by(address sender) internal {
        vm.recordLogs();
        vm.prank(sender);
    }

    /// @dev The next call comes from `sender`, and must be refused with this reason.
    function refused(address sender, string memory reason) internal {
        vm.prank(sender);
        vm.expectRevert(bytes(reason));
    }

    /// @dev The last call emitted exactly this event.
    function emitted(string memory signature, bytes memory indexedValues, bytes memory data) internal {
        Vm.Log[] memory logs = vm.getRecordedLogs();
        vm.assertEq(logs.length, 1, "one event");
        vm.assertEq(logs[0].emitter, address(authros), "emitter");
        bytes memory expected = abi.encodePacked(keccak256(bytes(signature)), indexedValues);
        vm.assertEq(abi.encodePacked(logs[0].topics), expected, "topics of the event");
        vm.assertEq(logs[0].data, data, "data of the event");
    }

    function accountOf(address owner) internal view returns (Account memory account) {
        (account.identity, account.epoch, account.token, account.suspended, account.keys, account.count, account.last) =
            authros.accountOf(owner);
    }

    function upload(address owner, uint256 digest, uint256 token) internal {
        by(owner);
        authros.dataUpload(abi.encode(digest), abi.encode(token), "7");
    }

    /// @dev A grant of all topics without end.
    function grant(address owner, address grantee, uint64 epoch) internal {
        by(owner);
        authros.authorityGrant(grantee, epoch, 0, topics(0), "envelope");
    }

    function wrap(address owner, address grantee, uint64 epoch) internal {
        by(owner);
        authros.wrap(only(grantee), epoch, only("envelope"));
    }

    function revoke(address owner, address grantee, uint256 newToken) internal {
        by(owner);
        authros.authorityRevoke(grantee, bytes32(newToken), "");
    }

    function rotate(address owner, uint256 newToken) internal {
        by(owner);
        authros.rotate(bytes32(newToken), "");
    }

    function mayRead(address reader, uint256 token, address owner) internal returns (bool authorised) {
        vm.prank(reader);
        (authorised,,,) = authros.dataQuery(abi.encode(token), owner);
    }
}
