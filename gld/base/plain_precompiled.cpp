// Nothing: the library gld_plain_headers exists for its precompiled header (plain_precompiled.h).
