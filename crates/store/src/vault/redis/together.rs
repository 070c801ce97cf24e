//! Several commands sent at once, and an answer read for each.
//!
//! The library's own pipeline goes on reading after a silence and waits for its time-out once for every answer that does
//! not come: 64 commands to a server that is stopped held the connection for three minutes.

use redis::{FromRedisValue, Pipeline, RedisResult, from_redis_value};

use super::connection::Connection;

/// The answers to all commands, in their order. Ends at the first silence; a command that the server refuses is
/// reported after all answers are read, so that the connection stays usable.
pub(super) fn ask<T: FromRedisValue>(connection: &mut Connection, commands: &Pipeline) -> RedisResult<Vec<T>> {
    if commands.is_empty() {
        return Ok(Vec::new());
    }
    connection.send(&commands.get_packed_pipeline())?;
    let values = connection.replies(commands.len())?;
    values.into_iter().map(|value| Ok(from_redis_value(value.extract_error()?)?)).collect()
}
