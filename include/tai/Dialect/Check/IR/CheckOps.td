//===- CheckOps.td - Programs that check themselves --------*- tablegen -*-===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//

#ifndef TAI_DIALECT_CHECK_IR_CHECKOPS_TD
#define TAI_DIALECT_CHECK_IR_CHECKOPS_TD

include "tai/Dialect/Check/IR/CheckOpBase.td"

def Check_Dialect : Dialect {
  let name = "tai_check";
  let cppNamespace = "::mlir::tai";
  let summary = "assertions about numbers and gradients in host programs";
  let description = [{
    Ops of a `func.func` that runs on the host, for self-checking tests: the
    program fails if a number or a gradient is not the expected one.

    They were ops of `tai` before, `tai.check_close` and `tai.check_gradient`.
    The parser still accepts these names; ops of the former names, from the
    generic form or from C++, are replaced by canonicalisation and when host
    functions are lowered.
  }];
  let dependentDialects = ["::mlir::tai::TaiDialect"];
}

def Check_CheckGradientOp : Check_GradientBase<Check_Dialect, "gradient"> {
  let summary = "compare a gradient with central differences";
  let description = [{
    Runs the region as `tai.tape` does, then compares the adjoint of each field
    of `wrt` with central differences of the loss along random directions with
    components of both signs, for a ladder of step sizes with Richardson
    extrapolation. The program fails if the best relative error exceeds
    `tolerance` for some direction. Fields should be f64. The fields of `wrt`
    and the loss are left as the tape left them.

    Elements that the region overwrites before it reads them, such as all steps
    but the first of a field with a time axis, are not checked, because their
    initial values have no effect. The program fails if no element is left to
    check.

    1. (check_gradient_c1) The loss is one of `tai.tape`, and (tape_c3) and
       (tape_c4) hold.
    2. (check_gradient_c2) Each field of `wrt` has an adjoint.

    Example:

    ```mlir
    tai_check.gradient loss(@loss) wrt [@x] tolerance 1.0e-7 {
      tai.launch @compute_loss() : () -> ()
    }
    ```
  }];
  let assemblyFormat = [{
    `loss` `(` $loss `)` `wrt` $wrt `tolerance` $tolerance $body attr-dict
  }];
}

def Check_CheckCloseOp : Check_CloseBase<Check_Dialect, "close"> {
  let summary = "fail unless two numbers agree";
  let description = [{
    The program fails, with both numbers and the location, unless |actual −
    expected| ≤ tolerance · max(1, |expected|).

    ```mlir
    tai_check.close %a, %b tolerance 1.0e-6 : f32
    ```
  }];
  let assemblyFormat = [{
    $actual `,` $expected `tolerance` $tolerance attr-dict `:` type($actual)
  }];
}

#endif // TAI_DIALECT_CHECK_IR_CHECKOPS_TD
