//===- DifferentiableInterfaces.td - Former place ---------*- tablegen -*-===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
// The file has moved; this name stays for one release.
//
//===----------------------------------------------------------------------===//

#ifndef TAI_AD_DIFFERENTIABLEINTERFACES_TD
#define TAI_AD_DIFFERENTIABLEINTERFACES_TD

include "tai/Interfaces/DifferentiableInterfaces.td"

#endif // TAI_AD_DIFFERENTIABLEINTERFACES_TD
