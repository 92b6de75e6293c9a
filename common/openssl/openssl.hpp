// Room: OpenSSL's functions, found when they are first needed (dlopen) and not when a program starts. So whoever uses
// Unix sockets alone needs no OpenSSL, and a solver may be linked with another version of it.
//
// Code in namespace rcb calls them by their names, which mean the pointers below there, also where OpenSSL's macros use
// them. One that is missing from the list is an undefined symbol when a program is linked, since none links OpenSSL.
#pragma once

#include <openssl/bio.h>
#include <openssl/crypto.h>
#include <openssl/err.h>
#include <openssl/evp.h>
#include <openssl/hmac.h>
#include <openssl/ssl.h>
#include <openssl/x509.h>

#include "common/base/status.hpp"

// clang-format off
#define RCB_OPENSSL_FUNCTIONS(DO) \
  DO(ASN1_INTEGER_set) DO(ASN1_TIME_set_string) DO(BIO_clear_flags) DO(BIO_get_data) DO(BIO_get_new_index)            \
  DO(BIO_meth_new) DO(BIO_meth_set_create) DO(BIO_meth_set_ctrl) DO(BIO_meth_set_read) DO(BIO_meth_set_write)         \
  DO(BIO_new) DO(BIO_set_data) DO(BIO_set_flags) DO(BIO_set_init) DO(BIO_test_flags) DO(CRYPTO_memcmp)                \
  DO(ERR_clear_error) DO(ERR_peek_last_error) DO(ERR_reason_error_string) DO(EVP_PKEY_Q_keygen) DO(EVP_PKEY_free)     \
  DO(EVP_sha256) DO(HMAC) DO(SSL_CTX_ctrl) DO(SSL_CTX_free) DO(SSL_CTX_new) DO(SSL_CTX_set_ciphersuites)              \
  DO(SSL_CTX_set_default_read_buffer_len) DO(SSL_CTX_set_num_tickets) DO(SSL_CTX_set_options) DO(SSL_CTX_set_verify)  \
  DO(SSL_CTX_use_PrivateKey) DO(SSL_CTX_use_certificate) DO(SSL_ctrl) DO(SSL_do_handshake) DO(SSL_free)               \
  DO(SSL_get1_peer_certificate) DO(SSL_get_error) DO(SSL_is_server) DO(SSL_new) DO(SSL_read_ex)                       \
  DO(SSL_set_accept_state) DO(SSL_set_bio) DO(SSL_set_connect_state) DO(SSL_set_msg_callback) DO(SSL_shutdown)        \
  DO(SSL_write_ex) DO(TLS_client_method) DO(TLS_server_method) DO(X509_NAME_add_entry_by_txt) DO(X509_digest)         \
  DO(X509_free) DO(X509_get_serialNumber) DO(X509_get_subject_name) DO(X509_getm_notAfter) DO(X509_getm_notBefore)    \
  DO(X509_gmtime_adj) DO(X509_new) DO(X509_set_issuer_name) DO(X509_set_pubkey) DO(X509_set_version) DO(X509_sign)
// clang-format on

namespace rcb {

#define RCB_OPENSSL_POINTER(name) inline decltype(&::name) name = nullptr;
RCB_OPENSSL_FUNCTIONS(RCB_OPENSSL_POINTER)
#undef RCB_OPENSSL_POINTER

// Sets the pointers, once; before that none may be called. Errors: unsupported (no OpenSSL here, or one that lacks a
// function).
Status open_openssl();

}  // namespace rcb
