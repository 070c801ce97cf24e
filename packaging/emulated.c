/* Checks a database in which AuthROS keeps its records, and copies it where a second name is given: `read FILE [COPY]`. */
#include <sqlite3.h>
#include <stdio.h>

static int failed(sqlite3 *database, const char *what) {
  fprintf(stderr, "%s: %s\n", what, sqlite3_errmsg(database));
  return 1;
}

int main(int count, char **words) {
  sqlite3 *database = NULL, *copy = NULL;
  sqlite3_stmt *check = NULL;
  if (count < 2 || sqlite3_open_v2(words[1], &database, SQLITE_OPEN_READONLY, NULL) != SQLITE_OK) return failed(database, "open");
  if (sqlite3_prepare_v2(database, "PRAGMA integrity_check", -1, &check, NULL) != SQLITE_OK) return failed(database, "check");
  if (sqlite3_step(check) != SQLITE_ROW) return failed(database, "check");
  const char *said = (const char *)sqlite3_column_text(check, 0);
  printf("SQLite %s on %zu bits: %s\n", sqlite3_libversion(), 8 * sizeof(void *), said);
  int sound = sqlite3_stricmp(said, "ok") == 0;
  sqlite3_finalize(check);
  if (count > 2) {
    if (sqlite3_open(words[2], &copy) != SQLITE_OK) return failed(copy, "copy");
    sqlite3_backup *backup = sqlite3_backup_init(copy, "main", database, "main");
    if (backup == NULL || sqlite3_backup_step(backup, -1) != SQLITE_DONE) return failed(copy, "copy");
    sqlite3_backup_finish(backup);
    /* Each page is written again by this machine. */
    if (sqlite3_exec(copy, "VACUUM", NULL, NULL, NULL) != SQLITE_OK) return failed(copy, "vacuum");
    sqlite3_close(copy);
  }
  sqlite3_close(database);
  return !sound;
}
