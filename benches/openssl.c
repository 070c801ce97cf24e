/* Times OpenSSL's SM2 for `authros bench`: reads `WORK BYTES` lines, does the work once and answers its nanoseconds.
   WORK is sign, verify, encrypt or decrypt, of so many bytes. Contexts are made for each message, as its users make
   them; keys are made once. What it calls is declared here, so that its headers need not be installed.
   Built by the bench itself:  cc -O2 openssl.c -l:libcrypto.so.3 */
#define _POSIX_C_SOURCE 199309L
#include <stddef.h>
#include <stdio.h>
#include <string.h>
#include <time.h>

typedef struct evp_pkey_st EVP_PKEY;
typedef struct evp_pkey_ctx_st EVP_PKEY_CTX;
typedef struct evp_md_st EVP_MD;
typedef struct evp_md_ctx_st EVP_MD_CTX;
typedef struct engine_st ENGINE;

extern const char *OpenSSL_version(int what);
extern EVP_PKEY *EVP_PKEY_Q_keygen(void *library, const char *properties, const char *type, ...);
extern EVP_PKEY_CTX *EVP_PKEY_CTX_new(EVP_PKEY *key, ENGINE *engine);
extern void EVP_PKEY_CTX_free(EVP_PKEY_CTX *context);
extern int EVP_PKEY_CTX_set1_id(EVP_PKEY_CTX *context, const void *id, int length);
extern const EVP_MD *EVP_sm3(void);
extern EVP_MD_CTX *EVP_MD_CTX_new(void);
extern void EVP_MD_CTX_free(EVP_MD_CTX *context);
extern void EVP_MD_CTX_set_pkey_ctx(EVP_MD_CTX *context, EVP_PKEY_CTX *key);
extern int EVP_DigestSignInit(EVP_MD_CTX *context, EVP_PKEY_CTX **key_context, const EVP_MD *digest, ENGINE *engine,
                              EVP_PKEY *key);
extern int EVP_DigestSign(EVP_MD_CTX *context, unsigned char *signature, size_t *length, const unsigned char *message,
                          size_t bytes);
extern int EVP_DigestVerifyInit(EVP_MD_CTX *context, EVP_PKEY_CTX **key_context, const EVP_MD *digest, ENGINE *engine,
                                EVP_PKEY *key);
extern int EVP_DigestVerify(EVP_MD_CTX *context, const unsigned char *signature, size_t length,
                            const unsigned char *message, size_t bytes);
extern int EVP_PKEY_encrypt_init(EVP_PKEY_CTX *context);
extern int EVP_PKEY_encrypt(EVP_PKEY_CTX *context, unsigned char *out, size_t *length, const unsigned char *in,
                            size_t bytes);
extern int EVP_PKEY_decrypt_init(EVP_PKEY_CTX *context);
extern int EVP_PKEY_decrypt(EVP_PKEY_CTX *context, unsigned char *out, size_t *length, const unsigned char *in,
                            size_t bytes);

#define LARGEST 4096

static EVP_PKEY *key;
static unsigned char text[LARGEST], out[LARGEST + 512], plain[LARGEST + 512];
static const char id[] = "1234567812345678";

static long long now(void)
{
    struct timespec at;
    clock_gettime(CLOCK_MONOTONIC, &at);
    return at.tv_sec * 1000000000LL + at.tv_nsec;
}

/* 0 where every step succeeds; the length of the signature is kept in `length`. */
static int signature(int make, size_t bytes, size_t *length)
{
    EVP_PKEY_CTX *key_context = EVP_PKEY_CTX_new(key, NULL);
    EVP_MD_CTX *context = EVP_MD_CTX_new();
    int failed = !key_context || !context || EVP_PKEY_CTX_set1_id(key_context, id, sizeof id - 1) <= 0;
    if (!failed) {
        EVP_MD_CTX_set_pkey_ctx(context, key_context);
        if (make) {
            *length = sizeof out;
            failed |= EVP_DigestSignInit(context, NULL, EVP_sm3(), NULL, key) <= 0;
            failed = failed || EVP_DigestSign(context, out, length, text, bytes) <= 0;
        } else {
            failed |= EVP_DigestVerifyInit(context, NULL, EVP_sm3(), NULL, key) <= 0;
            failed = failed || EVP_DigestVerify(context, out, *length, text, bytes) <= 0;
        }
    }
    EVP_MD_CTX_free(context);
    EVP_PKEY_CTX_free(key_context);
    return failed;
}

static int envelope(int make, size_t bytes, size_t *length)
{
    EVP_PKEY_CTX *context = EVP_PKEY_CTX_new(key, NULL);
    int failed = !context;
    if (!failed && make) {
        *length = sizeof out;
        failed = EVP_PKEY_encrypt_init(context) <= 0 || EVP_PKEY_encrypt(context, out, length, text, bytes) <= 0;
    } else if (!failed) {
        size_t opened = sizeof plain;
        failed = EVP_PKEY_decrypt_init(context) <= 0 || EVP_PKEY_decrypt(context, plain, &opened, out, *length) <= 0;
        failed = failed || opened != bytes || memcmp(plain, text, bytes) != 0;
    }
    EVP_PKEY_CTX_free(context);
    return failed;
}

int main(void)
{
    char work[8];
    unsigned long bytes;
    size_t length = 0;
    key = EVP_PKEY_Q_keygen(NULL, NULL, "SM2");
    if (!key)
        return 1;
    memset(text, 0x5a, sizeof text);
    printf("%s\n", OpenSSL_version(0));
    fflush(stdout);
    while (scanf("%7s %lu", work, &bytes) == 2 && bytes <= LARGEST) {
        int failed = 0;
        long long start, end;
        int signs = strcmp(work, "sign") == 0, verifies = strcmp(work, "verify") == 0;
        int encrypts = strcmp(work, "encrypt") == 0, decrypts = strcmp(work, "decrypt") == 0;
        if (signs + verifies + encrypts + decrypts != 1)
            return 1;
        if (verifies)
            failed |= signature(1, bytes, &length);
        if (decrypts)
            failed |= envelope(1, bytes, &length);
        start = now();
        if (signs || verifies)
            failed |= signature(signs, bytes, &length);
        else
            failed |= envelope(encrypts, bytes, &length);
        end = now();
        if (failed)
            return 1;
        printf("%lld\n", end - start);
        fflush(stdout);
    }
    return 0;
}
