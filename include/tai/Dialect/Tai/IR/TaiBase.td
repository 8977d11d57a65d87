//===- TaiBase.td - The tai dialect ------------------------*- tablegen -*-===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//

#ifndef TAI_DIALECT_TAI_IR_TAIBASE_TD
#define TAI_DIALECT_TAI_IR_TAIBASE_TD

include "mlir/IR/DialectBase.td"

def Tai_Dialect : Dialect {
  let name = "tai";
  let cppNamespace = "::mlir::tai";
  let summary = "parallel, differentiable kernels over layout-typed fields";
  let description = [{
    The `tai` dialect describes physical simulators as imperative, parallel
    kernels that read and write *fields*. The arithmetic of a kernel and the
    storage of a field are kept apart: a field is an element of a *tree*, and
    the type of the tree (`!tai.root<…>`) is its whole layout. Changing that
    type changes the generated code, never the results.

    Kernels are written with `scf`, `arith`, `math`, `vector` and the ops of
    this dialect, and are differentiated in this form: `tai-make-adjoint` turns
    a `tai.kernel` into the kernel that accumulates its gradient.
  }];
  let useDefaultTypePrinterParser = 1;
  let useDefaultAttributePrinterParser = 1;
  let dependentDialects = ["::mlir::arith::ArithDialect"];
  let hasConstantMaterializer = 1;
  let hasOperationAttrVerify = 1;
  let hasRegionArgAttrVerify = 1;
  let hasRegionResultAttrVerify = 1;
  let extraClassDeclaration = [{
    void registerTypes();
    void registerAttributes();
    void registerOps();
  }];
}

#endif // TAI_DIALECT_TAI_IR_TAIBASE_TD
