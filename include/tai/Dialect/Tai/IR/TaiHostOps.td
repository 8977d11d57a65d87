//===- TaiHostOps.td - Launches, tapes and checks ----------*- tablegen -*-===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
// What stands in a `func.func` that runs on the host. `tai.load` and
// `tai.store` may stand there too, for single elements.
//
//===----------------------------------------------------------------------===//

#ifndef TAI_DIALECT_TAI_IR_TAIHOSTOPS_TD
#define TAI_DIALECT_TAI_IR_TAIHOSTOPS_TD

include "tai/Dialect/Tai/IR/TaiOpBase.td"

let opDocGroup = HostOpGroup in {

def Tai_LaunchOp : Tai_Op<"launch", [
    DeclareOpInterfaceMethods<SymbolUserOpInterface>]> {
  let summary = "run a kernel";
  let description = [{
    Runs the kernel with the given arguments and waits for what it returns.
    Inside `tai.tape` the launch is recorded, to be replayed in reverse.

    1. (launch_c1) `kernel` names a `tai.kernel`.
    2. (launch_c2) Operands and results have the types of those of the kernel.

    Example:

    ```mlir
    tai.launch @step(%t) : (i32) -> ()
    ```
  }];
  let arguments = (ins FlatSymbolRefAttr:$kernel, Variadic<AnyType>:$operands);
  let results = (outs Variadic<AnyType>:$results);
  let assemblyFormat = [{
    $kernel `(` $operands `)` attr-dict `:` functional-type($operands, $results)
  }];
}

def Tai_TapeOp : Tai_Op<"tape", [
    SingleBlockImplicitTerminator<"YieldOp">, RecursiveMemoryEffects,
    DeclareOpInterfaceMethods<SymbolUserOpInterface>]> {
  let summary = "record launches and propagate gradients back through them";
  let description = [{
    Clears the adjoint fields and the loss, runs the region and records its
    launches, sets the adjoint of `loss` (a 0-D field with an adjoint) to one, and then runs
    the adjoints of the recorded launches in reverse order with the recorded
    arguments (paper, section 3.2). Launches that cannot reach the loss are
    skipped.

    Only launches are recorded. A number that a launch returns or the host reads
    from a field with an adjoint must not reach another launch or a field but
    through `tai.stop_gradient`, and the host must not store to a field that a
    launch before has accessed. Arithmetic on numbers from before the tape is
    free.

    1. (tape_c1) `loss` names a `tai.field` of a float, of rank 0.
    2. (tape_c2) The loss has an adjoint.
    3. (tape_c3) No value with a derivative goes from one launch to the next
       through the host.

    Example:

    ```mlir
    tai.tape loss(@loss) {
      tai.launch @step(%t) : (i32) -> ()
      tai.launch @compute_loss() : () -> ()
    }
    ```
  }];
  let arguments = (ins FlatSymbolRefAttr:$loss);
  let regions = (region SizedRegion<1>:$body);
  let assemblyFormat = "`loss` `(` $loss `)` $body attr-dict";
}

def Tai_CheckGradientOp : Tai_Op<"check_gradient", [
    SingleBlockImplicitTerminator<"YieldOp">, RecursiveMemoryEffects,
    DeclareOpInterfaceMethods<SymbolUserOpInterface>]> {
  let summary = "compare a gradient with central differences";
  let description = [{
    Runs the region as `tai.tape` does, then compares the adjoint of each field
    of `wrt` with central differences of the loss along random directions with
    components of both signs, for a ladder of step sizes with Richardson
    extrapolation. The program fails if the best relative error exceeds
    `tolerance` for some direction. Fields should be f64. The fields of `wrt`
    and the loss are left as the tape left them.

    Elements that the region overwrites before it reads them, such as all steps
    but the first of a field with a time axis, are left out: what they held does
    not matter. The program fails if nothing is left to be checked.

    1. (check_gradient_c1) The loss is one of `tai.tape`, and (tape_c3) holds.
    2. (check_gradient_c2) Each field of `wrt` has an adjoint.

    Example:

    ```mlir
    tai.check_gradient loss(@loss) wrt [@x] tolerance 1.0e-7 {
      tai.launch @compute_loss() : () -> ()
    }
    ```
  }];
  let arguments = (ins FlatSymbolRefAttr:$loss,
                       TypedArrayAttrBase<FlatSymbolRefAttr, "fields">:$wrt,
                       F64Attr:$tolerance);
  let regions = (region SizedRegion<1>:$body);
  let assemblyFormat = [{
    `loss` `(` $loss `)` `wrt` $wrt `tolerance` $tolerance $body attr-dict
  }];
}

def Tai_CheckCloseOp : Tai_Op<"check_close", [
    AllTypesMatch<["actual", "expected"]>, MemoryEffects<[MemWrite]>]> {
  let summary = "fail unless two numbers agree";
  let description = [{
    The program fails, and says both numbers and where, unless
    |actual − expected| ≤ tolerance · max(1, |expected|).

    ```mlir
    tai.check_close %a, %b tolerance 1.0e-6 : f32
    ```
  }];
  let arguments = (ins AnyFloat:$actual, AnyFloat:$expected,
                       F64Attr:$tolerance);
  let assemblyFormat = [{
    $actual `,` $expected `tolerance` $tolerance attr-dict `:` type($actual)
  }];
}

} // opDocGroup = HostOpGroup

#endif // TAI_DIALECT_TAI_IR_TAIHOSTOPS_TD
