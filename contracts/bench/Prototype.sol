// SPDX-License-Identifier: Apache-2.0
pragma solidity >=0.7.6 <0.9.0;
pragma abicoder v2;

/// @title The prototype's way, only to compare gas: whole ciphertexts and tokens lie on the chain
/// @notice Never deploy this for use. It follows the paper's description and has the flaws that AuthROS.sol
///         was written against: no revoke, no events, no check of sizes, and a token list that any account
///         can grow for any other.
/// @dev EU(d, sigma, v, Addr) of the paper: `records` is d, `token` sigma and `tokens` v.
contract Prototype {
    struct Record {
        bytes ciphertext;
        bytes timestamp;
    }

    struct Account {
        bytes token;
        bytes[] tokens;
        Record[] records;
    }

    mapping(address => Account) private accounts;

    /// @notice Registers the sender under a token.
    /// @param token in the paper the SM4 key itself
    function register(bytes calldata token) external {
        require(accounts[msg.sender].token.length == 0, "registered");
        require(token.length != 0, "empty");
        accounts[msg.sender].token = token;
    }

    /// @notice Stores a whole ciphertext on the chain.
    /// @param ciphertext the record, of any length
    /// @param token the sender's own
    /// @param timestamp when this was called, as the sender says
    function dataUpload(bytes calldata ciphertext, bytes calldata token, bytes calldata timestamp) external {
        Account storage account = accounts[msg.sender];
        require(account.token.length != 0, "unregistered");
        require(keccak256(token) == keccak256(account.token), "token");
        Record storage record = account.records.push();
        record.ciphertext = ciphertext;
        record.timestamp = timestamp;
    }

    /// @notice Puts the sender's token on the grantee's list.
    /// @param grantee who may read the sender's records from now on, for ever
    function authorityGrant(address grantee) external {
        require(accounts[msg.sender].token.length != 0, "unregistered");
        accounts[grantee].tokens.push(accounts[msg.sender].token);
    }

    /// @notice The owner's last ciphertext, for the owner and for those whose list has the owner's token.
    /// @dev The loop goes over a list that any account can grow.
    /// @param token the owner's
    /// @param owner whose records
    /// @return ciphertext of the last record
    /// @return timestamp of the last record
    function dataQuery(bytes calldata token, address owner)
        external
        view
        returns (bytes memory ciphertext, bytes memory timestamp)
    {
        Account storage account = accounts[owner];
        require(keccak256(token) == keccak256(account.token), "token");
        require(msg.sender == owner || holds(accounts[msg.sender].tokens, token), "authority");
        require(account.records.length != 0, "empty");
        Record storage record = account.records[account.records.length - 1];
        return (record.ciphertext, record.timestamp);
    }

    function holds(bytes[] storage tokens, bytes calldata token) private view returns (bool) {
        for (uint256 index = 0; index < tokens.length; index++) {
            if (keccak256(tokens[index]) == keccak256(token)) return true;
        }
        return false;
    }
}
