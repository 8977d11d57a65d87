//===- Shadows.cpp - Shadow execution in the C API ------------------------===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//

#include "Impl.h"

using namespace mlir::tai;

static bool isOff(TaiContext context) {
  return !context->session.getRuntime().options().instruments.shadow;
}

TaiStatus taiShadowRows(TaiContext context, const TaiShadowRow **rows,
                        int64_t *count) {
  return call(*context, [&]() -> TaiStatus {
    // Rows stay when the option is set to false again.
    if (isOff(context) && !tai_rt_shadows)
      return context->usage("kernels have no shadows: set the option 'shadow'");
    context->shadows = context->session.getRuntime().shadowLog().rows();
    context->shadowRows.clear();
    for (const runtime::ShadowRow &row : context->shadows)
      context->shadowRows.push_back(
          {row.operation.c_str(), row.kernel.c_str(), row.place.c_str(),
           row.precision, row.lost, row.cancellations, row.flips, row.nonFinite,
           row.errorMade, row.errorIn, row.bitsLost});
    *rows = context->shadowRows.data();
    *count = static_cast<int64_t>(context->shadowRows.size());
    return TAI_OK;
  });
}

TaiStatus taiShadowClear(TaiContext context) {
  return call(*context, [&]() -> TaiStatus {
    context->session.getRuntime().shadowLog().clear();
    return TAI_OK;
  });
}

template <typename T>
static void errorsOf(const void *floats, int64_t count, double *errors) {
  const T *at = static_cast<const T *>(floats);
  for (int64_t i = 0; i < count; ++i) {
    long double exact = runtime::shadow::read(at + i, at[i]);
    errors[i] = static_cast<double>(exact - at[i]);
  }
}

TaiStatus taiShadowErrors(TaiContext context, const void *floats, int32_t bits,
                          int64_t count, double *errors) {
  return call(*context, [&]() -> TaiStatus {
    if (isOff(context))
      return context->usage("kernels have no shadows: set the option 'shadow'");
    if (bits != 32 && bits != 64)
      return context->usage("floats in memory have shadows if they have 32 or "
                            "64 bits");
    (bits == 32 ? errorsOf<float> : errorsOf<double>)(floats, count, errors);
    return TAI_OK;
  });
}
