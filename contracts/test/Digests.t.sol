// SPDX-License-Identifier: Apache-2.0
pragma solidity >=0.7.6 <0.9.0;
pragma abicoder v2;

import {World} from "./World.sol";

contract DigestsTest is World {
    function test_an_upload_is_numbered_and_told() public {
        vm.roll(50);
        by(A);
        authros.dataUpload(abi.encode(uint256(1)), abi.encode(uint256(0xa1)), "yesterday");
        emitted(
            "DataUploaded(address,bytes32,bytes32,uint64,uint64,bytes)",
            abi.encode(A, uint256(1), uint256(0xa1)),
            abi.encode(uint64(1), uint64(1), bytes("yesterday"))
        );
        vm.assertEq(authros.uploadedAt(A, bytes32(uint256(1))), 50, "block");
        upload(A, 2, 0xa1);
        vm.assertEq(accountOf(A).count, 2, "count");
        vm.assertEq(accountOf(A).last, bytes32(uint256(2)), "last");
    }

    function test_a_digest_is_unique_per_owner_and_nobody_blocks_anothers() public {
        upload(B, 1, 0xb1);
        upload(A, 1, 0xa1);
        refused(A, "digest used");
        authros.dataUpload(abi.encode(uint256(1)), abi.encode(uint256(0xa1)), "7");
        vm.assertEq(accountOf(A).count, 1, "count");
    }

    function test_a_record_sealed_before_a_revoke_is_not_lost() public {
        grant(A, B, 1);
        revoke(A, B, 0xa2);
        by(A);
        authros.dataUpload(abi.encode(uint256(1)), abi.encode(uint256(0xa1)), "");
        emitted(
            "DataUploaded(address,bytes32,bytes32,uint64,uint64,bytes)",
            abi.encode(A, uint256(1), uint256(0xa1)),
            abi.encode(uint64(1), uint64(1), bytes(""))
        );
    }

    function test_the_token_must_be_the_owners() public {
        refused(A, "token unknown");
        authros.dataUpload(abi.encode(uint256(1)), abi.encode(uint256(0xb1)), "7");
        refused(A, "token unknown");
        authros.dataUpload(abi.encode(uint256(1)), abi.encode(uint256(0)), "7");
        refused(STRANGER, "unregistered");
        authros.dataUpload(abi.encode(uint256(1)), abi.encode(uint256(0xa1)), "7");
    }

    function test_digest_and_token_have_32_bytes_and_the_time_at_most() public {
        vm.assertEq(authros.LONGEST_TIMESTAMP(), 32, "longest");
        bytes memory good = filled(32, 0xa1);
        rotate(A, uint256(bytes32(0xa1a1a1a1a1a1a1a1a1a1a1a1a1a1a1a1a1a1a1a1a1a1a1a1a1a1a1a1a1a1a1a1)));
        for (uint256 length = 31; length <= 33; length += 2) {
            refused(A, "length");
            authros.dataUpload(filled(length, 0xa1), good, "7");
            refused(A, "length");
            authros.dataUpload(good, filled(length, 0xa1), "7");
        }
        refused(A, "length");
        authros.dataUpload(good, good, filled(33, 1));
        by(A);
        authros.dataUpload(good, good, filled(32, 1));
        vm.assertEq(accountOf(A).count, 1, "count");
    }

    function test_a_query_answers_owner_and_grantee_only() public {
        upload(A, 5, 0xa1);
        grant(A, B, 1);
        address[3] memory readers = [A, B, C];
        for (uint256 index = 0; index < readers.length; index++) {
            bool may = readers[index] != C;
            vm.prank(readers[index]);
            (bool authorised, uint64 epoch, uint64 count, bytes32 last) =
                authros.dataQuery(abi.encode(uint256(0xa1)), A);
            vm.assertEq(authorised, may, "authorised");
            vm.assertEq(epoch, 1, "epoch");
            vm.assertEq(count, may ? 1 : 0, "count");
            vm.assertEq(last, bytes32(uint256(may ? 5 : 0)), "last");
        }
    }

    function test_a_query_under_an_unknown_token_tells_nothing() public {
        upload(A, 5, 0xa1);
        vm.prank(A);
        (bool authorised, uint64 epoch, uint64 count, bytes32 last) = authros.dataQuery(abi.encode(uint256(0xb1)), A);
        vm.assertEq(authorised, false, "authorised");
        vm.assertEq(epoch + count, 0, "numbers");
        vm.assertEq(last, bytes32(0), "last");
        refused(A, "length");
        authros.dataQuery(filled(31, 1), A);
    }

    function test_anchors_are_chained_per_sender() public {
        refused(A, "previous");
        authros.anchor(bytes32(uint256(1)), 5, bytes32(uint256(9)));
        refused(A, "previous");
        authros.anchor(bytes32(uint256(1)), 5, bytes32(type(uint256).max));
        vm.assertEq(authros.headOf(A), bytes32(0), "no root yet");
        vm.assertEq(authros.headOf(STRANGER), bytes32(0), "nor any of a stranger");
        vm.roll(70);
        by(A);
        authros.anchor(bytes32(uint256(1)), 5, bytes32(0));
        emitted(
            "Anchored(address,bytes32,uint64,bytes32)", abi.encode(A, uint256(1)), abi.encode(uint64(5), uint256(0))
        );
        vm.assertEq(authros.headOf(A), bytes32(uint256(1)), "head");
        refused(A, "previous");
        authros.anchor(bytes32(uint256(2)), 5, bytes32(0));
        by(B);
        authros.anchor(bytes32(uint256(2)), 5, bytes32(0));
        by(A);
        authros.anchor(bytes32(uint256(2)), 6, bytes32(uint256(1)));
        emitted(
            "Anchored(address,bytes32,uint64,bytes32)", abi.encode(A, uint256(2)), abi.encode(uint64(6), uint256(1))
        );
    }

    function test_where_a_root_is_anchored_twice_the_earliest_counts() public {
        vm.roll(70);
        by(A);
        authros.anchor(bytes32(uint256(1)), 5, bytes32(0));
        by(A);
        authros.rotateKeys(identity(0xa1, 2), "");
        vm.roll(71);
        vm.warp(1001);
        by(A);
        authros.anchor(bytes32(uint256(1)), 6, bytes32(uint256(1)));
        (uint64 blockNumber, uint64 count, uint64 time, uint64 keys) = authros.anchorOf(A, bytes32(uint256(1)));
        vm.assertEq(blockNumber, 70, "block");
        vm.assertEq(count, 5, "count");
        vm.assertEq(time, 1000, "time");
        vm.assertEq(keys, 1, "keys");
        (blockNumber, count, time, keys) = authros.anchorOf(B, bytes32(uint256(1)));
        vm.assertEq(blockNumber + count + time + keys, 0, "another account's");
    }

    function test_an_anchor_names_the_version_of_the_keys() public {
        by(A);
        authros.rotateKeys(identity(0xa1, 2), "");
        by(A);
        authros.anchor(bytes32(uint256(1)), 5, bytes32(0));
        (,,, uint64 keys) = authros.anchorOf(A, bytes32(uint256(1)));
        vm.assertEq(keys, 2, "keys");
    }

    function test_nothing_empty_is_anchored() public {
        refused(A, "empty");
        authros.anchor(bytes32(0), 5, bytes32(0));
        refused(A, "empty");
        authros.anchor(bytes32(type(uint256).max), 5, bytes32(0));
        refused(A, "empty");
        authros.anchor(bytes32(uint256(1)), 0, bytes32(0));
        refused(STRANGER, "unregistered");
        authros.anchor(bytes32(uint256(1)), 5, bytes32(0));
    }
}
