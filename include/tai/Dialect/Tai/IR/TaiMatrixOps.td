//===- TaiMatrixOps.td - Small vectors and matrices --------*- tablegen -*-===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
// Small dense algebra on `vector<n x f>` and `vector<n x m x f>`. Each op has
// an analytic derivative, and therefore stays one op until after
// differentiation. Elementwise work is `arith` and `math` on vectors.
//
//===----------------------------------------------------------------------===//

#ifndef TAI_DIALECT_TAI_IR_TAIMATRIXOPS_TD
#define TAI_DIALECT_TAI_IR_TAIMATRIXOPS_TD

include "tai/Dialect/Tai/IR/TaiOpBase.td"

class Tai_MatrixOp<string mnemonic, list<Trait> traits = []>
    : Tai_Op<mnemonic, !listconcat([Pure], traits)> {
  let hasVerifier = 1;
}

/// Base class of ops whose result has a shape made from those of the operands.
/// The verifier of the op reports a wrong result, and names the right type.
class Tai_ShapedMatrixOp<string mnemonic, list<Trait> traits = []>
    : Tai_MatrixOp<mnemonic, !listconcat(traits, [
        DeclareOpInterfaceMethods<InferTypeOpInterface,
                                  ["refineReturnTypes"]>])> {
  let extraClassDefinition = [{
    ::llvm::LogicalResult $cppClass::refineReturnTypes(
        ::mlir::MLIRContext *, ::std::optional<::mlir::Location>,
        ::mlir::ValueRange, ::mlir::DictionaryAttr, ::mlir::OpaqueProperties,
        ::mlir::RegionRange, ::llvm::SmallVectorImpl<::mlir::Type> &) {
      return ::mlir::success();
    }
  }];
}

let opDocGroup = MatrixOpGroup in {

def Tai_MatmulOp : Tai_ShapedMatrixOp<"matmul"> {
  let summary = "matrix-matrix or matrix-vector product";
  let description = [{
    The product of an n×k matrix and a k×m matrix, or an n×k matrix and a
    vector of k.

    ```mlir
    %c = tai.matmul %a, %b : (vector<2x3xf32>, vector<3x2xf32>) -> vector<2x2xf32>
    ```
  }];
  let arguments = (ins Tai_NumberMatrix:$lhs,
                       AnyTypeOf<[Tai_NumberMatrix, Tai_NumberVector]>:$rhs);
  let results = (outs AnyTypeOf<[Tai_NumberMatrix, Tai_NumberVector]>:$result);
  let assemblyFormat = "$lhs `,` $rhs attr-dict `:` functional-type(operands, results)";
}

def Tai_TransposeOp : Tai_ShapedMatrixOp<"transpose"> {
  let summary = "transpose of a matrix";
  let description = [{
    ```mlir
    %t = tai.transpose %a : vector<2x3xf32> -> vector<3x2xf32>
    ```
  }];
  let arguments = (ins Tai_NumberMatrix:$matrix);
  let results = (outs Tai_NumberMatrix:$result);
  let assemblyFormat = "$matrix attr-dict `:` type($matrix) `->` type($result)";
  let hasFolder = 1;
  let hasCanonicalizeMethod = 1;
}

def Tai_DotOp : Tai_MatrixOp<"dot", [AllTypesMatch<["lhs", "rhs"]>,
    TypesMatchWith<"result is the element type", "lhs", "result",
                   "::llvm::cast<::mlir::VectorType>($_self).getElementType()">]> {
  let summary = "sum of the products of components";
  let description = [{
    Σ aᵢ bᵢ over all components; matrices are taken componentwise too.

    ```mlir
    %d = tai.dot %a, %b : vector<3xf32>
    ```
  }];
  let arguments = (ins VectorOfAnyRankOf<[AnySignlessInteger, AnyFloat]>:$lhs,
                       VectorOfAnyRankOf<[AnySignlessInteger, AnyFloat]>:$rhs);
  let results = (outs AnyTypeOf<[AnySignlessInteger, AnyFloat]>:$result);
  let assemblyFormat = "$lhs `,` $rhs attr-dict `:` type($lhs)";
  let hasVerifier = 0;
}

def Tai_SumOp : Tai_MatrixOp<"sum", [
    TypesMatchWith<"result is the element type", "vector", "result",
                   "::llvm::cast<::mlir::VectorType>($_self).getElementType()">]> {
  let summary = "sum of all components";
  let description = [{
    ```mlir
    %s = tai.sum %a : vector<2x2xf32>
    ```
  }];
  let arguments = (ins VectorOfAnyRankOf<[AnySignlessInteger, AnyFloat]>:$vector);
  let results = (outs AnyTypeOf<[AnySignlessInteger, AnyFloat]>:$result);
  let assemblyFormat = "$vector attr-dict `:` type($vector)";
  let hasVerifier = 0;
}

def Tai_CrossOp : Tai_MatrixOp<"cross", [
    AllTypesMatch<["lhs", "rhs", "result"]>]> {
  let summary = "cross product of two 3-vectors";
  let description = [{
    ```mlir
    %c = tai.cross %a, %b : vector<3xf32>
    ```
  }];
  let arguments = (ins Tai_NumberVector:$lhs, Tai_NumberVector:$rhs);
  let results = (outs Tai_NumberVector:$result);
  let assemblyFormat = "$lhs `,` $rhs attr-dict `:` type($lhs)";
}

def Tai_OuterOp : Tai_ShapedMatrixOp<"outer"> {
  let summary = "outer product of two vectors";
  let description = [{
    The matrix aᵢ bⱼ.

    ```mlir
    %m = tai.outer %a, %b : (vector<2xf32>, vector<3xf32>) -> vector<2x3xf32>
    ```
  }];
  let arguments = (ins Tai_NumberVector:$lhs, Tai_NumberVector:$rhs);
  let results = (outs Tai_NumberMatrix:$result);
  let assemblyFormat = "$lhs `,` $rhs attr-dict `:` functional-type(operands, results)";
}

def Tai_NormOp : Tai_MatrixOp<"norm", [
    TypesMatchWith<"result is the element type", "vector", "result",
                   "::llvm::cast<::mlir::VectorType>($_self).getElementType()">]> {
  let summary = "Euclidean norm of all components";
  let description = [{
    √(Σ aᵢ²). The derivative is a/‖a‖, and zero at a = 0.

    If the sum of squares over- or underflows, components are scaled first, so
    that the norm is accurate whenever it is representable. `fast` omits this.

    ```mlir
    %l = tai.norm %a : vector<2xf32>
    %m = tai.norm fast %a : vector<2xf32>
    ```
  }];
  let arguments = (ins VectorOfAnyRankOf<[AnyFloat]>:$vector, UnitAttr:$fast);
  let results = (outs AnyFloat:$result);
  let assemblyFormat = "(`fast` $fast^)? $vector attr-dict `:` type($vector)";
  let hasVerifier = 0;
}

def Tai_StopGradientOp : Tai_Op<"stop_gradient", [
    Pure, AllTypesMatch<["value", "result"]>]> {
  let summary = "a value that is constant for differentiation";
  let description = [{
    The operand. No derivative passes through.

    ```mlir
    %b = tai.stop_gradient %a : vector<2xf32>
    ```
  }];
  let arguments = (ins AnyTypeOf<[AnyFloat, VectorOfAnyRankOf<[AnyFloat]>]>:$value);
  let results = (outs AnyTypeOf<[AnyFloat, VectorOfAnyRankOf<[AnyFloat]>]>:$result);
  let assemblyFormat = "$value attr-dict `:` type($value)";
}

def Tai_DeriveAsOp : Tai_Op<"derive_as", [
    Pure, AllTypesMatch<["value", "form", "result"]>]> {
  let summary = "a value whose derivative is that of another one";
  let description = [{
    The first operand. Derivatives pass through the second one only, so that a
    value can be computed in one way and differentiated in another. Created and
    removed during differentiation, for functions of the singular values or
    eigenvalues of a matrix.

    ```mlir
    %r = tai.derive_as %value, %form : vector<2x2xf32>
    ```
  }];
  let arguments = (ins AnyTypeOf<[AnyFloat, VectorOfAnyRankOf<[AnyFloat]>]>:$value,
                       AnyTypeOf<[AnyFloat, VectorOfAnyRankOf<[AnyFloat]>]>:$form);
  let results = (outs AnyTypeOf<[AnyFloat, VectorOfAnyRankOf<[AnyFloat]>]>:$result);
  let assemblyFormat = "$value `,` $form attr-dict `:` type($value)";
}

def Tai_GradOp : Tai_Op<"grad", [
    DeclareOpInterfaceMethods<SymbolUserOpInterface>]> {
  let summary = "the derivative of a function where it is used";
  let description = [{
    Calls the derivative of a `func.func` by reverse mode. The operands are, in
    this order: the arguments of the function; for each active argument that is
    a memref, the memref that its gradient is added to; for each active result,
    the number or vector that its derivative is multiplied by. The results are
    the gradients of the active arguments that are numbers or vectors.

    `wrt` has the positions of the active arguments, and `of` those of the
    active results, both ascending. Without them, all arguments and results of
    floats are active; an argument of a float that is not active is constant.
    The function itself does not run. Its derivative reads the memrefs as they
    are.

    `tai-expand-gradients` makes the derivative and a call of it.

    1. (grad_c1) `callee` names a `func.func` with a body.
    2. (grad_c2) The positions are ascending, and those of floats, of vectors or
       memrefs of floats.
    3. (grad_c3) The operands and results are as above.
    4. (grad_c4) An argument is active, and so is a result or a memref.

    Example:

    ```mlir
    func.func @energy(%x: f64, %k: f64) -> f64 {
      %0 = arith.mulf %x, %x : f64
      %1 = arith.mulf %0, %k : f64
      return %1 : f64
    }
    func.func @force(%x: f64, %k: f64) -> f64 {
      %seed = arith.constant -1.0 : f64
      %0 = tai.grad @energy(%x, %k, %seed) wrt [0] : (f64, f64, f64) -> f64
      return %0 : f64
    }
    ```
  }];
  let arguments = (ins FlatSymbolRefAttr:$callee, Variadic<AnyType>:$operands,
                       OptionalAttr<DenseI64ArrayAttr>:$wrt,
                       OptionalAttr<DenseI64ArrayAttr>:$of);
  let results = (outs Variadic<AnyType>:$results);
  let assemblyFormat = [{
    $callee `(` $operands `)` (`wrt` $wrt^)? (`of` $of^)? attr-dict `:`
    functional-type($operands, $results)
  }];
  let extraClassDeclaration = [{
    /// The positions of the active arguments of `function`, and of its active
    /// results. `function` must have been verified.
    ::llvm::SmallVector<int64_t> getActiveArguments(
        ::mlir::FunctionOpInterface function);
    ::llvm::SmallVector<int64_t> getActiveResults(
        ::mlir::FunctionOpInterface function);
  }];
}

def Tai_TraceOp : Tai_MatrixOp<"trace", [
    TypesMatchWith<"result is the element type", "matrix", "result",
                   "::llvm::cast<::mlir::VectorType>($_self).getElementType()">]> {
  let summary = "sum of the diagonal of a square matrix";
  let description = [{
    ```mlir
    %t = tai.trace %a : vector<3x3xf32>
    ```
  }];
  let arguments = (ins Tai_NumberMatrix:$matrix);
  let results = (outs AnyTypeOf<[AnySignlessInteger, AnyFloat]>:$result);
  let assemblyFormat = "$matrix attr-dict `:` type($matrix)";
  let hasFolder = 1;
}

def Tai_DeterminantOp : Tai_MatrixOp<"determinant", [
    TypesMatchWith<"result is the element type", "matrix", "result",
                   "::llvm::cast<::mlir::VectorType>($_self).getElementType()">]> {
  let summary = "determinant of a square matrix of size 1 to 4";
  let description = [{
    By cofactors. The derivative is the cofactor matrix, which exists for
    singular matrices too.

    ```mlir
    %d = tai.determinant %a : vector<3x3xf32>
    ```
  }];
  let arguments = (ins Tai_FloatMatrix:$matrix);
  let results = (outs AnyFloat:$result);
  let assemblyFormat = "$matrix attr-dict `:` type($matrix)";
}

def Tai_InverseOp : Tai_MatrixOp<"inverse", [
    AllTypesMatch<["matrix", "result"]>]> {
  let summary = "inverse of a square matrix of size 1 to 4";
  let description = [{
    Adjugate over determinant; not finite for a singular matrix. The derivative
    is dA⁻¹ = −A⁻¹ dA A⁻¹.

    ```mlir
    %i = tai.inverse %a : vector<2x2xf32>
    ```
  }];
  let arguments = (ins Tai_FloatMatrix:$matrix);
  let results = (outs Tai_FloatMatrix:$result);
  let assemblyFormat = "$matrix attr-dict `:` type($matrix)";
}

def Tai_SolveOp : Tai_MatrixOp<"solve", [
    AllTypesMatch<["rhs", "result"]>]> {
  let summary = "solve a square linear system of size 1 to 4";
  let description = [{
    The x with A x = b. The derivative is that of A⁻¹ b.

    ```mlir
    %x = tai.solve %a, %b : vector<3x3xf32>, vector<3xf32>
    ```
  }];
  let arguments = (ins Tai_FloatMatrix:$matrix, Tai_FloatVector:$rhs);
  let results = (outs Tai_FloatVector:$result);
  let assemblyFormat = "$matrix `,` $rhs attr-dict `:` type($matrix) `,` type($rhs)";
}

def Tai_PolarOp : Tai_MatrixOp<"polar", [
    AllTypesMatch<["matrix", "rotation", "stretch"]>]> {
  let summary = "polar decomposition of a 2×2 or 3×3 matrix";
  let description = [{
    A = R S with R a rotation and S symmetric. The derivative of R is that of
    the rotation nearest to A; it is finite wherever σᵢ + σⱼ is not zero.

    ```mlir
    %r, %s = tai.polar %a : vector<2x2xf32>
    ```
  }];
  let arguments = (ins Tai_FloatMatrix:$matrix);
  let results = (outs Tai_FloatMatrix:$rotation, Tai_FloatMatrix:$stretch);
  let assemblyFormat = "$matrix attr-dict `:` type($matrix)";
}

def Tai_SvdOp : Tai_MatrixOp<"svd", [
    AllTypesMatch<["matrix", "u", "sigma", "v"]>]> {
  let summary = "singular value decomposition of a 2×2 or 3×3 matrix";
  let description = [{
    A = U Σ Vᵀ with rotations U and V and diagonal Σ, singular values in
    descending order, the last one negative where det A is.

    ```mlir
    %u, %s, %v = tai.svd %a : vector<3x3xf32>
    ```
  }];
  let arguments = (ins Tai_FloatMatrix:$matrix);
  let results = (outs Tai_FloatMatrix:$u, Tai_FloatMatrix:$sigma,
                      Tai_FloatMatrix:$v);
  let assemblyFormat = "$matrix attr-dict `:` type($matrix)";
}

def Tai_SymEigOp : Tai_ShapedMatrixOp<"sym_eig", [
    AllTypesMatch<["matrix", "vectors"]>]> {
  let summary = "eigenvalues and eigenvectors of a symmetric matrix";
  let description = [{
    The eigendecomposition of a symmetric 2×2 or 3×3 matrix (the lower triangle
    is read): the eigenvalues in descending order, and the matrix whose columns
    are the eigenvectors.

    ```mlir
    %l, %q = tai.sym_eig %a : vector<2x2xf32> -> vector<2xf32>
    ```
  }];
  let arguments = (ins Tai_FloatMatrix:$matrix);
  let results = (outs Tai_FloatVector:$values, Tai_FloatMatrix:$vectors);
  let assemblyFormat = "$matrix attr-dict `:` type($matrix) `->` type($values)";
}

} // opDocGroup = MatrixOpGroup

#endif // TAI_DIALECT_TAI_IR_TAIMATRIXOPS_TD
