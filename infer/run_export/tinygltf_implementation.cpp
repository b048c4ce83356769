// The library is a header; this is where it is compiled, without the image code that it would bring along.
#define TINYGLTF_IMPLEMENTATION
#include <tiny_gltf.h>
