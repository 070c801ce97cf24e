// SPDX-License-Identifier: Apache-2.0
pragma solidity >=0.7.6 <0.9.0;
pragma abicoder v2;

import {World} from "./World.sol";

contract GrantsTest is World {
    function test_a_grant_lets_the_grantee_read() public {
        vm.assertEq(mayRead(B, 0xa1, A), false, "before");
        by(A);
        authros.authorityGrant(B, 1, 2000, topics(2), "envelope");
        emitted(
            "Granted(address,address,uint64,uint64,bytes16[],bytes)",
            abi.encode(A, B),
            abi.encode(uint64(1), uint64(2000), topics(2), bytes("envelope"))
        );
        (bool active, uint64 epoch, uint64 expiry, uint64 revokes, bytes32 scope) = authros.grantOf(A, B);
        vm.assertEq(active, true, "active");
        vm.assertEq(epoch, 1, "epoch");
        vm.assertEq(expiry, 2000, "expiry");
        vm.assertEq(revokes, 0, "revokes");
        vm.assertEq(scope, keccak256(abi.encodePacked(uint256(1) << 128, uint256(2) << 128)), "scope");
        vm.assertEq(mayRead(B, 0xa1, A), true, "after");
        vm.assertEq(mayRead(A, 0xb1, B), false, "not the other way round");
        vm.assertEq(mayRead(C, 0xa1, A), false, "nobody else");
    }

    function test_the_scope_of_all_topics_is_zero() public {
        grant(A, B, 1);
        (,,,, bytes32 scope) = authros.grantOf(A, B);
        vm.assertEq(scope, bytes32(0), "scope");
    }

    function test_a_grant_keeps_its_limits() public {
        vm.assertEq(authros.MOST_TOPICS(), 32, "topics");
        vm.assertEq(authros.LONGEST_ENVELOPE(), 4096, "envelope");
        refused(A, "self");
        authros.authorityGrant(A, 1, 0, topics(0), "envelope");
        refused(A, "grantee");
        authros.authorityGrant(STRANGER, 1, 0, topics(0), "envelope");
        refused(A, "epoch");
        authros.authorityGrant(B, 0, 0, topics(0), "envelope");
        refused(A, "epoch");
        authros.authorityGrant(B, 2, 0, topics(0), "envelope");
        refused(A, "scope");
        authros.authorityGrant(B, 1, 0, topics(33), "envelope");
        refused(A, "envelope");
        authros.authorityGrant(B, 1, 0, topics(0), "");
        refused(A, "envelope");
        authros.authorityGrant(B, 1, 0, topics(0), filled(4097, 1));
        refused(STRANGER, "unregistered");
        authros.authorityGrant(B, 1, 0, topics(0), "envelope");
        by(A);
        authros.authorityGrant(B, 1, 0, topics(32), filled(4096, 1));
        vm.assertEq(mayRead(B, 0xa1, A), true, "at the limits");
    }

    function test_a_grant_expires() public {
        refused(A, "expired");
        authros.authorityGrant(B, 1, 1000, topics(0), "envelope");
        by(A);
        authros.authorityGrant(B, 1, 1010, topics(0), "envelope");
        vm.warp(1009);
        vm.assertEq(mayRead(B, 0xa1, A), true, "in the last second");
        vm.warp(1010);
        vm.assertEq(mayRead(B, 0xa1, A), false, "at its end");
        rotate(A, 0xa2);
        refused(A, "no grant");
        authros.wrap(only(B), 2, only("envelope"));
        revoke(A, B, 0xa3);
        vm.assertEq(mayRead(B, 0xa3, A), false, "revoked");
    }

    function test_an_expired_grant_is_renewed_for_a_further_epoch() public {
        by(A);
        authros.authorityGrant(B, 1, 1010, topics(0), "envelope");
        vm.warp(1010);
        rotate(A, 0xa2);
        rotate(A, 0xa3);
        grant(A, B, 3);
        vm.assertEq(mayRead(B, 0xa1, A), true, "the epoch whose envelope it holds");
        vm.assertEq(mayRead(B, 0xa2, A), false, "the epoch in between");
        vm.assertEq(mayRead(B, 0xa3, A), true, "the new epoch");
    }

    function test_a_revoke_ends_the_epoch_and_keeps_the_other_grantees() public {
        grant(A, B, 1);
        grant(A, C, 1);
        by(A);
        authros.authorityRevoke(B, bytes32(uint256(0xa2)), "");
        emitted("Revoked(address,address,uint64,bytes32)", abi.encode(A, B), abi.encode(uint64(2), uint256(0xa2)));
        vm.assertEq(accountOf(A).epoch, 2, "epoch");
        vm.assertEq(accountOf(A).token, bytes32(uint256(0xa2)), "token");
        (bool active,,, uint64 revokes,) = authros.grantOf(A, B);
        vm.assertEq(active, false, "active");
        vm.assertEq(revokes, 1, "revokes");
        vm.assertEq(mayRead(B, 0xa1, A), false, "the old epoch");
        vm.assertEq(mayRead(B, 0xa2, A), false, "the new epoch");
        vm.assertEq(mayRead(C, 0xa1, A), true, "the other's old epoch");
        vm.assertEq(mayRead(C, 0xa2, A), true, "the other's new epoch");
    }

    function test_a_revoke_needs_a_grant_of_the_sender_and_a_fresh_token() public {
        grant(A, B, 1);
        refused(A, "no grant");
        authros.authorityRevoke(C, bytes32(uint256(0xa2)), "");
        refused(C, "no grant");
        authros.authorityRevoke(B, bytes32(uint256(0xc2)), "");
        refused(STRANGER, "unregistered");
        authros.authorityRevoke(B, bytes32(uint256(7)), "");
        refused(A, "token used");
        authros.authorityRevoke(B, bytes32(uint256(0xa1)), "");
        refused(A, "empty");
        authros.authorityRevoke(B, bytes32(0), "");
        vm.assertEq(mayRead(B, 0xa1, A), true, "a refused revoke changes nothing");
        revoke(A, B, 0xa2);
        refused(A, "no grant");
        authros.authorityRevoke(B, bytes32(uint256(0xa3)), "");
    }

    function test_who_is_granted_anew_reads_no_earlier_epoch_without_its_envelope() public {
        grant(A, B, 1);
        revoke(A, B, 0xa2);
        grant(A, B, 2);
        vm.assertEq(mayRead(B, 0xa1, A), false, "the envelope of before the revoke does not count");
        vm.assertEq(mayRead(B, 0xa2, A), true, "the new epoch");
        wrap(A, B, 1);
        vm.assertEq(mayRead(B, 0xa1, A), true, "given again");
    }

    function test_one_envelope_per_epoch_and_another_only_for_new_keys_or_after_a_revoke() public {
        grant(A, B, 1);
        refused(A, "wrapped");
        authros.authorityGrant(B, 1, 0, topics(1), "envelope");
        refused(A, "wrapped");
        authros.wrap(only(B), 1, only("envelope"));
        by(B);
        authros.rotateKeys(identity(0xb1, 2), "");
        by(A);
        authros.wrap(only(B), 1, only("again"));
        emitted("Wrapped(address,address,uint64,bytes)", abi.encode(A, B), abi.encode(uint64(1), bytes("again")));
        (uint64 revokes, uint64 keys) = authros.envelopeOf(A, B, 1);
        vm.assertEq(revokes, 0, "revokes");
        vm.assertEq(keys, 2, "keys");
        refused(A, "wrapped");
        authros.wrap(only(B), 1, only("envelope"));
        revoke(A, B, 0xa2);
        grant(A, B, 1);
        (revokes, keys) = authros.envelopeOf(A, B, 1);
        vm.assertEq(revokes, 1, "revokes");
    }

    function test_wrapping_gives_many_grantees_an_epoch() public {
        grant(A, B, 1);
        grant(A, C, 1);
        rotate(A, 0xa2);
        address[] memory grantees = new address[](2);
        (grantees[0], grantees[1]) = (B, C);
        bytes[] memory envelopes = new bytes[](2);
        (envelopes[0], envelopes[1]) = (bytes("b"), bytes("c"));
        by(A);
        authros.wrap(grantees, 2, envelopes);
        vm.assertEq(vm.getRecordedLogs().length, 2, "an event for each");
        grantees[1] = B;
        refused(A, "wrapped");
        authros.wrap(grantees, 1, envelopes);
    }

    function test_only_grantees_get_envelopes_and_only_of_begun_epochs() public {
        grant(A, B, 1);
        refused(A, "no grant");
        authros.wrap(only(C), 1, only("envelope"));
        refused(C, "no grant");
        authros.wrap(only(B), 1, only("envelope"));
        refused(A, "epoch");
        authros.wrap(only(B), 2, only("envelope"));
        refused(A, "epoch");
        authros.wrap(only(B), 0, only("envelope"));
        refused(STRANGER, "unregistered");
        authros.wrap(only(B), 1, only("envelope"));
        rotate(A, 0xa2);
        refused(A, "envelope");
        authros.wrap(only(B), 2, only(""));
    }

    function test_a_call_wraps_at_most_32_and_an_envelope_for_each() public {
        vm.assertEq(authros.MOST_WRAPS(), 32, "wraps");
        refused(A, "length");
        authros.wrap(new address[](33), 1, new bytes[](33));
        refused(A, "length");
        authros.wrap(new address[](2), 1, new bytes[](1));
        address[] memory grantees = new address[](32);
        bytes[] memory envelopes = new bytes[](32);
        for (uint160 index = 0; index < 32; index++) {
            grantees[index] = address(0xd0000 + index);
            envelopes[index] = "envelope";
            register(grantees[index], 1);
            grant(A, grantees[index], 1);
        }
        rotate(A, 0xa2);
        by(A);
        authros.wrap(grantees, 2, envelopes);
        vm.assertEq(vm.getRecordedLogs().length, 32, "events");
    }

    function test_a_grant_is_extended_without_a_revoke() public {
        by(A);
        authros.authorityGrant(B, 1, 2000, topics(2), "envelope");
        (,,,, bytes32 scope) = authros.grantOf(A, B);
        by(A);
        authros.extend(B, 2001);
        emitted("Extended(address,address,uint64)", abi.encode(A, B), abi.encode(uint64(2001)));
        (bool active, uint64 epoch, uint64 expiry, uint64 revokes, bytes32 kept) = authros.grantOf(A, B);
        vm.assertEq(active, true, "active");
        vm.assertEq(epoch, 1, "epoch");
        vm.assertEq(expiry, 2001, "expiry");
        vm.assertEq(revokes, 0, "revokes");
        vm.assertEq(kept, scope, "scope");
        vm.assertEq(accountOf(A).epoch, 1, "the epoch goes on");
        vm.warp(2000);
        vm.assertEq(mayRead(B, 0xa1, A), true, "in the longer time");
        by(A);
        authros.extend(B, 0);
        vm.warp(1 << 40);
        vm.assertEq(mayRead(B, 0xa1, A), true, "without end");
    }

    function test_a_grant_is_never_shortened_and_an_ended_one_not_revived() public {
        refused(A, "no grant");
        authros.extend(B, 2000);
        by(A);
        authros.authorityGrant(B, 1, 2000, topics(0), "envelope");
        grant(A, C, 1);
        refused(A, "shorter");
        authros.extend(B, 2000);
        refused(A, "shorter");
        authros.extend(B, 1999);
        refused(A, "shorter");
        authros.extend(C, 2000);
        refused(A, "shorter");
        authros.extend(C, 0);
        refused(B, "no grant");
        authros.extend(A, 3000);
        refused(STRANGER, "unregistered");
        authros.extend(B, 3000);
        vm.warp(2000);
        refused(A, "no grant");
        authros.extend(B, 3000);
        revoke(A, C, 0xa2);
        refused(A, "no grant");
        authros.extend(C, 3000);
    }

    function test_a_suspended_grantee_reads_nothing_until_restored() public {
        grant(A, B, 1);
        by(ADMIN);
        authros.suspend(B);
        vm.assertEq(mayRead(B, 0xa1, A), false, "suspended");
        vm.assertEq(mayRead(B, 0xb1, B), true, "what is his own");
        by(ADMIN);
        authros.restore(B);
        vm.assertEq(mayRead(B, 0xa1, A), true, "restored");
    }
}
