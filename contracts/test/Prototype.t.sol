// SPDX-License-Identifier: Apache-2.0
pragma solidity >=0.7.6 <0.9.0;
pragma abicoder v2;

import {Prototype} from "../bench/Prototype.sol";
import {Cheats} from "./Vm.sol";

/// @dev The bench-only contract does what the paper says, so that its gas is a fair comparison.
contract PrototypeTest is Cheats {
    address private constant A = address(0xa0000);
    address private constant B = address(0xb0000);
    bytes private constant TOKEN_A = "the SM4 key of A";
    bytes private constant TOKEN_B = "the SM4 key of B";

    Prototype private prototype;

    function setUp() public {
        prototype = new Prototype();
        vm.prank(A);
        prototype.register(TOKEN_A);
        vm.prank(B);
        prototype.register(TOKEN_B);
    }

    function test_whole_ciphertexts_lie_on_the_chain() public {
        bytes memory ciphertext = abi.encodePacked(keccak256("first half"), keccak256("second half"), "rest");
        vm.prank(A);
        prototype.dataUpload("earlier", TOKEN_A, "6");
        vm.prank(A);
        prototype.dataUpload(ciphertext, TOKEN_A, "7");
        vm.prank(A);
        (bytes memory found, bytes memory timestamp) = prototype.dataQuery(TOKEN_A, A);
        vm.assertEq(found, ciphertext, "ciphertext");
        vm.assertEq(timestamp, "7", "timestamp");
    }

    function test_who_has_the_owners_token_on_the_list_reads() public {
        vm.prank(A);
        prototype.dataUpload("ciphertext", TOKEN_A, "7");
        refused(B, "authority");
        prototype.dataQuery(TOKEN_A, A);
        vm.prank(B);
        prototype.authorityGrant(B);
        vm.prank(A);
        prototype.authorityGrant(B);
        vm.prank(B);
        (bytes memory found,) = prototype.dataQuery(TOKEN_A, A);
        vm.assertEq(found, "ciphertext", "ciphertext");
    }

    function test_what_the_prototype_refuses() public {
        refused(A, "registered");
        prototype.register(TOKEN_B);
        refused(address(0xff0000), "empty");
        prototype.register("");
        refused(address(0xff0000), "unregistered");
        prototype.dataUpload("ciphertext", "", "7");
        refused(address(0xff0000), "unregistered");
        prototype.authorityGrant(A);
        refused(A, "token");
        prototype.dataUpload("ciphertext", TOKEN_B, "7");
        refused(A, "token");
        prototype.dataQuery(TOKEN_B, A);
        refused(A, "empty");
        prototype.dataQuery(TOKEN_A, A);
    }

    function refused(address sender, string memory reason) private {
        vm.prank(sender);
        vm.expectRevert(bytes(reason));
    }
}
