// Nothing: the library gld_torch_headers exists for its precompiled header (torch_precompiled.h).
