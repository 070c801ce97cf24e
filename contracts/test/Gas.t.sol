// SPDX-License-Identifier: Apache-2.0
pragma solidity >=0.7.6 <0.9.0;
pragma abicoder v2;

import {AuthROS} from "../AuthROS.sol";
import {Prototype} from "../bench/Prototype.sol";
import {World} from "./World.sol";

/// @dev What calls cost as transactions of their own (forge test --isolate), for gas.txt; and that the cost of anchoring
///      does not grow with anything. No random input, so the figures change only with the contract.
abstract contract Gas is World {
    uint256 private constant DEVICE = type(uint256).max;
    uint64 private constant COUNTS = 5;

    /// @dev The rules of the network: each call is a transaction under them.
    function evm() internal pure virtual returns (string memory);

    function setUp() public override {
        vm.setEvmVersion(evm());
        vm.warp(1700000000);
        vm.roll(1000);
        authros = deploy(true);
        register(A, token(1));
        register(B, token(1));
        register(C, token(1));
    }

    function test_gas_of_accounts() public {
        by(STRANGER);
        authros.register(identity(token(1), 0xaa), filled(400, 0xee));
        note("register");
        by(A);
        authros.rotateKeys(identity(token(1), 0xbb), filled(400, 0xee));
        note("rotateKeys");
        by(A);
        authros.rotate(bytes32(token(2)), filled(400, 0xee));
        note("rotate");
        by(A);
        authros.lend(bytes32(DEVICE), 1800000000);
        note("lend");
        by(A);
        authros.recall(bytes32(DEVICE));
        note("recall");
    }

    function test_gas_of_uploads_and_anchors() public {
        uploadNow(1);
        note("dataUpload, the first");
        uint256 each = uploadNow(2);
        note("dataUpload");
        uint256 batch = anchorNow(A, 1, 256);
        note("anchor, the first");
        uint64[COUNTS] memory leaves = [uint64(1), 16, 256, 4096, 16384];
        string[COUNTS] memory names = [
            "anchor of 1 record",
            "anchor of 16 records",
            "anchor of 256 records",
            "anchor of 4096 records",
            "anchor of 16384 records"
        ];
        vm.assertLe(batch, 70000, "the first batch");
        for (uint256 index = 0; index < COUNTS; index++) {
            uint256 further = anchorNow(A, index + 2, leaves[index]);
            note(names[index]);
            if (index > 0) vm.assertEq(further, batch, "the cost does not grow with the records");
            batch = further;
        }
        vm.assertLe(batch, 70000, "a batch");
        vm.assertLe(150 * batch, 256 * each, "at 256 records 150 times cheaper than each by itself");
    }

    function test_gas_does_not_grow_with_users_and_records() public {
        uploadNow(1);
        anchorNow(A, 1, 256);
        uint256 upload = uploadNow(2);
        uint256 anchored = anchorNow(A, 2, 256);
        for (uint160 index = 1; index <= 100; index++) {
            address other = address(0xd0000 + index);
            register(other, token(1));
            grant(other, A, 1);
            grant(A, other, 1);
            anchorNow(other, index, 256);
            uploadNow(10 + index);
        }
        vm.assertEq(uploadNow(3), upload, "an upload");
        vm.assertEq(anchorNow(A, 3, 256), anchored, "an anchor");
    }

    function test_gas_of_grants() public {
        by(A);
        authros.authorityGrant(B, 1, 1800000000, topics(0), filled(400, 0xee));
        note("authorityGrant, all topics, envelope of 400 bytes");
        by(A);
        authros.authorityGrant(C, 1, 1800000000, topics(32), filled(2000, 0xee));
        note("authorityGrant, 32 topics, envelope of 2000 bytes");
        by(A);
        authros.extend(B, 1800000001);
        note("extend");
        by(A);
        authros.authorityRevoke(B, bytes32(token(2)), filled(400, 0xee));
        note("authorityRevoke");
        by(A);
        authros.wrap(only(C), 2, only(filled(400, 0xee)));
        note("wrap for 1 grantee");
        address[] memory grantees = new address[](32);
        bytes[] memory envelopes = new bytes[](32);
        for (uint160 index = 0; index < 32; index++) {
            grantees[index] = address(0xd0000 + index);
            envelopes[index] = filled(400, 0xee);
            register(grantees[index], token(1));
            grant(A, grantees[index], 1);
        }
        by(A);
        authros.wrap(grantees, 2, envelopes);
        note("wrap for 32 grantees");
    }

    function test_gas_of_the_administrator() public {
        by(ADMIN);
        authros.admit(STRANGER);
        note("admit");
        by(ADMIN);
        authros.setOpen(false);
        note("setOpen");
        by(ADMIN);
        authros.suspend(A);
        note("suspend");
        by(ADMIN);
        authros.restore(A);
        note("restore");
        by(ADMIN);
        authros.dismiss(STRANGER);
        note("dismiss");
        by(ADMIN);
        authros.pause(1700000100);
        note("pause");
        by(ADMIN);
        authros.resume();
        note("resume");
        by(A);
        authros.nameRecovery(C);
        note("nameRecovery");
        by(ADMIN);
        authros.proposeSuccession(A, B);
        note("proposeSuccession");
        by(ADMIN);
        authros.cancelSuccession(A);
        note("cancelSuccession");
        by(ADMIN);
        authros.proposeSuccession(A, B);
        vm.warp(1700000000 + 2 * DELAY);
        by(ADMIN);
        authros.completeSuccession(A);
        note("completeSuccession");
        by(ADMIN);
        authros.nominate(C);
        note("nominate");
        by(C);
        authros.acceptAdministrator();
        note("acceptAdministrator");
    }

    function test_gas_of_the_prototype() public {
        Prototype prototype = new Prototype();
        vm.prank(A);
        prototype.register(filled(16, 0xaa));
        string[4] memory names =
            ["prototype, 1 KB on the chain", "prototype, 2 KB", "prototype, 4 KB", "prototype, 8 KB"];
        for (uint256 index = 0; index < 4; index++) {
            bytes memory ciphertext = filled(1024 << index, 0xee);
            vm.prank(A);
            prototype.dataUpload(ciphertext, filled(16, 0xaa), filled(10, 0x31));
            note(names[index]);
        }
    }

    function note(string memory name) private {
        vm.snapshotGasLastCall(evm(), name);
    }

    function token(uint256 number) private pure returns (uint256) {
        return word(number) ^ word(0x80);
    }

    /// @dev A word without a zero byte, since these are cheaper.
    function word(uint256 number) private pure returns (uint256) {
        return number * (type(uint256).max / 255);
    }

    function uploadNow(uint256 number) private returns (uint256 gas) {
        bytes memory time = filled(10, 0x31);
        by(A);
        authros.dataUpload(abi.encode(word(number)), abi.encode(token(1)), time);
        return vm.lastCallGas().gasTotalUsed;
    }

    function anchorNow(address who, uint256 number, uint64 count) private returns (uint256 gas) {
        bytes32 previous = authros.headOf(who);
        by(who);
        authros.anchor(bytes32(word(number)), count, previous);
        return vm.lastCallGas().gasTotalUsed;
    }
}

/// @dev What an old private network charges, and this program's embedded chain.
contract GasIstanbulTest is Gas {
    function evm() internal pure override returns (string memory) {
        return "istanbul";
    }
}

/// @dev What a new network charges.
contract GasOsakaTest is Gas {
    function evm() internal pure override returns (string memory) {
        return "osaka";
    }
}
