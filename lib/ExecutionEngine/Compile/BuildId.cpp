//===- BuildId.cpp - Identity of the compiler build -----------------------===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// The linker gives each library a build id, a hash of its contents. The id is
// read from memory, because the file may have been replaced. Size and time of a
// file do not distinguish two builds that were installed from packages.
//
//===----------------------------------------------------------------------===//

#include "BuildId.h"
#include "mlir/IR/Dialect.h"
#include "mlir/IR/Verifier.h"
#include "tai/ABI/Abi.h"
#include "tai/Support/XXHash.h"
#include "llvm/ADT/STLExtras.h"
#include "llvm/ADT/StringExtras.h"
#include "llvm/Config/llvm-config.h"
#include "llvm/Support/Path.h"
#include "llvm/Support/raw_ostream.h"
#include "llvm/TargetParser/Host.h"
#include <link.h>
#include <mutex>

using namespace llvm;

namespace {
/// A library, or the program itself, loaded into the memory of the process.
struct Image {
  uintptr_t base;
  SmallVector<ElfW(Phdr)> segments;
  StringRef soname;
  SmallVector<StringRef> needed;

  bool contains(const void *address) const {
    uintptr_t at = reinterpret_cast<uintptr_t>(address) - base;
    return any_of(segments, [&](const ElfW(Phdr) & segment) {
      return segment.p_type == PT_LOAD &&
             at - segment.p_vaddr < segment.p_memsz;
    });
  }
  StringRef getBytes(const ElfW(Phdr) & segment) const {
    return StringRef(reinterpret_cast<const char *>(base + segment.p_vaddr),
                     segment.p_memsz);
  }
  void readDynamicSection(const char *path);
  std::string getId() const;
};
} // namespace

/// Reads the name of a loaded library, and the names of the libraries that it
/// depends on.
void Image::readDynamicSection(const char *path) {
  soname = sys::path::filename(path);
  for (const ElfW(Phdr) &segment : segments) {
    if (segment.p_type != PT_DYNAMIC)
      continue;
    auto *entries = reinterpret_cast<const ElfW(Dyn) *>(base + segment.p_vaddr);
    uintptr_t strings = 0;
    for (auto *entry = entries; entry->d_tag != DT_NULL; ++entry)
      if (entry->d_tag == DT_STRTAB)
        strings = entry->d_un.d_ptr;
    // Not every loader adds the base of the library to the address of its
    // string table.
    if (strings < base)
      strings += base;
    if (!any_of(segments, [&](const ElfW(Phdr) & other) {
          return other.p_type == PT_LOAD &&
                 strings - base - other.p_vaddr < other.p_memsz;
        }))
      continue;
    auto *text = reinterpret_cast<const char *>(strings);
    for (auto *entry = entries; entry->d_tag != DT_NULL; ++entry) {
      if (entry->d_tag == DT_SONAME)
        soname = text + entry->d_un.d_val;
      else if (entry->d_tag == DT_NEEDED)
        needed.push_back(text + entry->d_un.d_val);
    }
  }
}

/// Finds the build id in a segment of notes of a library; nothing if there is
/// none.
static std::optional<StringRef> findBuildId(StringRef notes, size_t alignment) {
  while (notes.size() >= sizeof(ElfW(Nhdr))) {
    ElfW(Nhdr) header;
    std::memcpy(&header, notes.data(), sizeof(header));
    notes = notes.drop_front(sizeof(header));
    size_t name = alignTo(header.n_namesz, alignment);
    size_t size = alignTo(header.n_descsz, alignment);
    if (name > notes.size() || header.n_descsz > notes.size() - name)
      break;
    if (header.n_type == NT_GNU_BUILD_ID &&
        notes.take_front(header.n_namesz) == StringRef("GNU\0", 4))
      return notes.substr(name, header.n_descsz);
    notes = notes.drop_front(std::min(name + size, notes.size()));
  }
  return std::nullopt;
}

/// Returns the linker's build id of a library; without one, a checksum of all
/// its read-only memory.
std::string Image::getId() const {
  for (const ElfW(Phdr) &segment : segments)
    if (segment.p_type == PT_NOTE)
      if (auto id =
              findBuildId(getBytes(segment), segment.p_align == 8 ? 8 : 4))
        return toHex(*id, /*LowerCase=*/true);
  uint64_t sum = 0;
  for (const ElfW(Phdr) &segment : segments)
    if (segment.p_type == PT_LOAD && (segment.p_flags & PF_R) &&
        !(segment.p_flags & PF_W)) {
      StringRef bytes = getBytes(segment);
      sum = mlir::tai::runtime::xxh64(bytes.data(), bytes.size(), sum);
    }
  return "sum-" + utohexstr(sum, /*LowerCase=*/true);
}

namespace {
/// All loaded libraries, and those of their ids that have been requested so
/// far.
class Images {
public:
  /// Returns the ids of the libraries that contain one of these addresses, or
  /// that depend on a library that contains one of the first `numLibraries`
  /// addresses.
  SmallVector<std::string> getIds(ArrayRef<const void *> addresses,
                                  size_t numLibraries);

private:
  static int add(dl_phdr_info *info, size_t size, void *images);
  void update();

  std::vector<std::pair<Image, std::string>> images;
  unsigned long long loads = 0, unloads = 0;
};
} // namespace

int Images::add(dl_phdr_info *info, size_t, void *images) {
  Image image;
  image.base = info->dlpi_addr;
  image.segments.append(info->dlpi_phdr, info->dlpi_phdr + info->dlpi_phnum);
  image.readDynamicSection(info->dlpi_name);
  static_cast<Images *>(images)->images.emplace_back(std::move(image), "");
  return 0;
}

void Images::update() {
  unsigned long long counts[2] = {0, 0};
  dl_iterate_phdr(
      [](dl_phdr_info *info, size_t, void *counts) {
        auto *numbers = static_cast<unsigned long long *>(counts);
        numbers[0] = info->dlpi_adds;
        numbers[1] = info->dlpi_subs;
        return 1;
      },
      counts);
  if (!images.empty() && counts[0] == loads && counts[1] == unloads)
    return;
  loads = counts[0];
  unloads = counts[1];
  images.clear();
  dl_iterate_phdr(&Images::add, this);
}

SmallVector<std::string> Images::getIds(ArrayRef<const void *> addresses,
                                        size_t numLibraries) {
  update();
  SmallVector<StringRef> libraries;
  for (const void *address : addresses.take_front(numLibraries))
    for (auto &[image, id] : images)
      if (image.contains(address))
        libraries.push_back(image.soname);
  SmallVector<std::string> ids;
  for (auto &[image, id] : images) {
    bool takesPart = any_of(addresses,
                            [&, &image = image](const void *address) {
                              return image.contains(address);
                            }) ||
                     any_of(image.needed, [&](StringRef name) {
                       return is_contained(libraries, name);
                     });
    if (!takesPart)
      continue;
    if (id.empty())
      id = image.getId();
    ids.push_back(id);
  }
  // The ids are sorted, since the order in which libraries were loaded does not
  // matter.
  sort(ids);
  ids.erase(llvm::unique(ids), ids.end());
  return ids;
}

std::string mlir::tai::getBuildId(MLIRContext *context) {
  SmallVector<const void *> addresses = {
      reinterpret_cast<const void *>(&getBuildId),
      reinterpret_cast<const void *>(&mlir::verify),
      reinterpret_cast<const void *>(&sys::getProcessTriple)};
  size_t numLibraries = addresses.size();
  // The object of a plugin's dialect begins with the address of its vtable,
  // which is in the plugin.
  for (Dialect *dialect : context->getLoadedDialects())
    addresses.push_back(*reinterpret_cast<const void *const *>(dialect));
  static std::mutex mutex;
  static Images images;
  std::lock_guard<std::mutex> lock(mutex);
  std::string text;
  raw_string_ostream(text) << "tai abi " << TAI_ABI_VERSION << " llvm "
                           << LLVM_VERSION_STRING << ' '
                           << join(images.getIds(addresses, numLibraries), ",");
  return text;
}
