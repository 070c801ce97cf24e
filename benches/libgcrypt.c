/* Times libgcrypt for `authros bench`: reads `WORK BYTES` lines, does the work once and answers its nanoseconds.
   WORK is sm3 (digest), seal or open (SM4-GCM with key set-up, nonce, 32 bytes of AAD and the tag).
   Built by the bench itself:  cc -O2 libgcrypt.c -lgcrypt */
#define _POSIX_C_SOURCE 199309L
#include <gcrypt.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <time.h>

#define LARGEST (64u << 20)

static const unsigned char key[16] = {0x01, 0x23, 0x45, 0x67, 0x89, 0xab, 0xcd, 0xef,
                                      0xfe, 0xdc, 0xba, 0x98, 0x76, 0x54, 0x32, 0x10};
static const unsigned char nonce[12];
static const unsigned char aad[32];
static unsigned char *text;

static long long now(void)
{
    struct timespec at;
    clock_gettime(CLOCK_MONOTONIC, &at);
    return at.tv_sec * 1000000000LL + at.tv_nsec;
}

static int digest(size_t bytes)
{
    unsigned char out[32];
    gcry_md_hash_buffer(GCRY_MD_SM3, out, text, bytes);
    return 0;
}

/* 0 where every step succeeds; the tag of `open` is that of what `seal` left behind. */
static int cipher(int seal, size_t bytes, unsigned char tag[16])
{
    gcry_cipher_hd_t handle;
    int failed = gcry_cipher_open(&handle, GCRY_CIPHER_SM4, GCRY_CIPHER_MODE_GCM, 0) != 0;
    if (failed)
        return 1;
    failed |= gcry_cipher_setkey(handle, key, sizeof key) != 0;
    failed |= gcry_cipher_setiv(handle, nonce, sizeof nonce) != 0;
    failed |= gcry_cipher_authenticate(handle, aad, sizeof aad) != 0;
    gcry_cipher_final(handle);
    if (seal) {
        failed |= gcry_cipher_encrypt(handle, text, bytes, NULL, 0) != 0;
        failed |= gcry_cipher_gettag(handle, tag, 16) != 0;
    } else {
        failed |= gcry_cipher_decrypt(handle, text, bytes, NULL, 0) != 0;
        failed |= gcry_cipher_checktag(handle, tag, 16) != 0;
    }
    gcry_cipher_close(handle);
    return failed;
}

int main(void)
{
    char work[8];
    unsigned long bytes;
    unsigned char tag[16];
    if (!gcry_check_version(NULL))
        return 1;
    gcry_control(GCRYCTL_DISABLE_SECMEM, 0);
    gcry_control(GCRYCTL_INITIALIZATION_FINISHED, 0);
    text = malloc(LARGEST);
    if (!text)
        return 1;
    memset(text, 0x5a, LARGEST);
    printf("libgcrypt %s\n", gcry_check_version(NULL));
    fflush(stdout);
    while (scanf("%7s %lu", work, &bytes) == 2 && bytes <= LARGEST) {
        int failed = 0;
        long long start, end;
        if (strcmp(work, "open") == 0)
            failed |= cipher(1, bytes, tag);
        start = now();
        if (strcmp(work, "sm3") == 0)
            failed |= digest(bytes);
        else
            failed |= cipher(strcmp(work, "seal") == 0, bytes, tag);
        end = now();
        if (failed)
            return 1;
        printf("%lld\n", end - start);
        fflush(stdout);
    }
    return 0;
}
