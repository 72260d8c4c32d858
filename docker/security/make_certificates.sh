#!/bin/sh
# make_certificates.sh FOLDER HOST: an authority of our own, and certificates that it signs for the service and a client.
set -eu
folder=$1 host=$2 days=825
umask 077
mkdir -p "$folder"
cd "$folder"
openssl req -x509 -newkey ec -pkeyopt ec_paramgen_curve:prime256v1 -nodes -days "$days" \
  -subj "/CN=gpdf authority" -keyout ca.key -out ca.pem 2>/dev/null
for who in service client; do
  [ "$who" = service ] && name=$host || name=client
  openssl req -newkey ec -pkeyopt ec_paramgen_curve:prime256v1 -nodes -subj "/CN=$name" \
    -keyout "$who.key" -out "$who.csr" 2>/dev/null
  printf 'subjectAltName=DNS:%s\nbasicConstraints=CA:FALSE\n' "$name" > "$who.ext"
  openssl x509 -req -in "$who.csr" -CA ca.pem -CAkey ca.key -CAcreateserial -days "$days" \
    -extfile "$who.ext" -out "$who.pem" 2>/dev/null
  rm "$who.csr" "$who.ext"
done
